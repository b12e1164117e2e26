"""Drafts a step table from the text of a protocol with a language model, and corrects it until it is proved.

The model only proposes: `pcmrs.authoring.design` and `pcmrs.fsm.verify` decide. A drafted workflow carries its
provenance, with which a daemon refuses it until a person has approved it.
"""
