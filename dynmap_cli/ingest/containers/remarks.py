"""What is said of a file that was read: what was done to read it, or lies beside it and is not read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Remark:
    """One sentence of it.

    Attributes
    ----------
    words : str
    is_loss : bool
        Whether something of the recording is lost, which counts as damage.
    """

    words: str
    is_loss: bool = False
