"""What a person with a pointer is asked."""

from __future__ import annotations

from pcmrs.messages.base import Message


class LandmarkPrompt(Message, frozen=True, kw_only=True):
    """Asks the person with the pointer to touch one landmark.

    Attributes:
        index: From 0, in the order of the plan.
        position_in_image: Where the plan has it, m: what the person sees on the screen.
    """

    index: int
    name: str
    position_in_image: tuple[float, float, float]
