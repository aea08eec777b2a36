"""What a plan is made for: one arm (`doe.observations.Observer`) or two (`doe.two_arms.TwoArmObserver`).

Search, bounds, guard and judgement need no more than this of either.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from identify.arrays import Floats
from identify.effects import Parameter
from identify.identifiability import Dropped
from identify.study import PlanSettings

__all__ = ["Subject"]


class Subject(Protocol):
    """What is asked, and what may be unknown."""

    @property
    def path(self) -> Path:
        """The study file."""

    @property
    def settings(self) -> PlanSettings:
        """What the plan is asked for."""

    @property
    def reference(self) -> str:
        """What readings are compared with, in words."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """(p,) all parameters, the columns of blocks."""

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) their names."""

    @property
    def nuisance(self) -> np.ndarray:
        """(p,) True for frames and markers."""

    @property
    def weights(self) -> Floats:
        """(t,) weights of the test poses as stated; empty without test poses."""

    def test_rows(self) -> Floats:
        """(t, 3, p) error that counts at each test pose, m per unit of each parameter."""

    def why(self, dropped: Dropped) -> str:
        """In words, why a parameter cannot be identified."""
