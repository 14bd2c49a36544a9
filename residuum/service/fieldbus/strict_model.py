"""What a description of a bus or of what is watched is read into: fixed once read, and what it does
not know is refused.
"""

from pydantic import BaseModel, ConfigDict


class StrictModel(BaseModel):
    """A part of such a description."""

    model_config = ConfigDict(extra="forbid", frozen=True)
