"""What could be reached by somebody who knows the cause: a fit of the true model, judged on poses held out."""

import numpy as np

from tests.blind.cases import Case
from tests.blind.faults import base_handles
from tests.blind.physics import respond


def rms(error: np.ndarray) -> float:
    """Root mean square length of vectors (..., 3)."""
    return float(np.sqrt((error**2).sum(axis=-1).mean()))


def oracle_error(case: Case, true: np.ndarray, given) -> float:
    """RMS (m) of the true model, fitted to the case's readings, at other conditions.

    Args:
        case: A case whose rows are not spoiled.
        true: (P, L, M, 3) what is read there without noise.
        given: The conditions there.
    """
    handles = [*base_handles(), *(handle for fault in case.faults for handle in fault.handles)]
    readings = case.table.xyz.reshape(*case.given.load.shape, -1, 3) * 1e-3
    columns = case.lens.columns(handles, case.world)
    rest = case.lens.whiten(readings - respond(case.world, case.given))
    length = np.linalg.norm(columns, axis=0)
    seen = length > 0
    sizes = np.zeros(len(handles))
    unit = columns[:, seen] / length[seen]
    sizes[seen] = np.linalg.lstsq(unit, rest, rcond=1e-7)[0] / length[seen]
    fitted = case.world
    for handle, size in zip(handles, sizes, strict=True):
        fitted = handle(fitted, size)
    return rms(respond(fitted, given) - true)
