"""The only unit conversions: files speak mm, deg and um; the code speaks m and rad.

Multiply a number from a file by its unit to get SI; divide to get back.
"""

from __future__ import annotations

import math

__all__ = ["DEG", "GPA", "HOUR", "MM", "MRAD", "PPM", "SI_OF", "UM", "URAD", "clock", "counted"]

MM = 1e-3
UM = 1e-6
DEG = math.pi / 180.0
MRAD = 1e-3
URAD = 1e-6
GPA = 1e9
PPM = 1e-6
HOUR = 3600.0

#: SI value of one unit, by the unit's name as it stands in result files.
SI_OF = {
    "mm": MM,
    "mrad": MRAD,
    "urad/Nm": URAD,
    "um/N": UM,
    "urad/N": URAD,
    "N/mm": 1e3,
    "N": 1.0,
    "Nm": 1.0,
    "kg": 1.0,
    "kg m": 1.0,
    "%": 0.01,
    "urad": URAD,
    "um": UM,
    "urad/kNm^3": URAD / 1e9,
    "um/kN^3": UM / 1e9,
    "mrad/rad": MRAD,
    "ppm": PPM,
    "ppm/K": PPM,
    "urad/K": URAD,
    "um/K": UM,
    "mm/h": MM / HOUR,
    "mrad/h": MRAD / HOUR,
}


def clock(seconds: float) -> str:
    """A time in s as hours and minutes."""
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes:02d} min"


def counted(number: int, noun: str) -> str:
    """A number of things in words: ``1 pose``, ``2 poses``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
