"""A virtual cabinet that speaks the protocol of the KST 1.7 server of a KUKA iiwa, on the simulated arm.

It was written from the public sources of the server (KUKA Sunrise Toolbox 1.7, its Java application for the cabinet),
and was not compared with a real cabinet.
"""
