"""How big a hidden cause is: as big as it takes to show with a wanted energy."""

import numpy as np

from tests.blind import hidden
from tests.blind.faults import Fault
from tests.blind.physics import respond
from tests.blind.whitening import Lens

LAMBDA = (60.0, 2000.0)
# Two causes at once and strangers must show more before they can be judged; a compensator usually is a matter of mm.
WIDE = {
    "pair": (150.0, 2000.0),
    "outside": (400.0, 4000.0),
    "gravity_compensator": (2e3, 1e5),
    "outside:hose": (1.5e3, 1e4),
}


def sized(rng, name, group, setting, given, lens, energy):
    """A fault and the size at which it has the wanted energy beyond the base model."""
    if energy is None:
        energy = 5.0 if group == "below" else float(np.exp(rng.uniform(*np.log(LAMBDA))))
        wide = WIDE.get(name, WIDE.get(group)) if group in {"single", "outside"} else WIDE.get(group)
        if wide and (group != "single" or rng.random() < 0.5):
            energy = float(np.exp(rng.uniform(*np.log(wide))))
    best = None
    for _ in range(12):
        fault = _drawn(rng, name, group, setting, given)
        size, reached = _size_for(fault, lens, energy)
        if best is None or reached > best[2]:
            best = (fault, size, reached)
        if reached > 0.95 * energy:
            break
    return best[:2]


def _drawn(rng, name, group, setting, given):
    """One draw; exact twins stand where they are exact."""
    fault = hidden.draw(rng, name, setting, given.time)
    while group == "confounded" and fault.where in {"j1", "j3", "j4", "j5", "j6"} and name == "transmission_error":
        fault = hidden.draw(rng, name, setting, given.time)
    return fault


def _size_for(fault: Fault, lens: Lens, energy: float):
    """Smallest size with this energy, by bisection on a grid; the largest plausible one if none has it."""
    start = respond(lens.world, lens.given)

    def shown(size):
        return lens.remains(lens.whiten(respond(fault.apply(lens.world, size), lens.given) - start))

    grid = fault.largest * np.geomspace(1e-4, 1.0, 9)
    values = np.array([shown(size) for size in grid])
    enough = np.flatnonzero(values >= energy)
    if not len(enough):
        top = int(np.argmax(values))
        return float(grid[top]), values[top]
    high = grid[enough[0]]
    low = grid[enough[0] - 1] if enough[0] else 0.0
    for _ in range(14):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if shown(middle) < energy else (low, middle)
    return float(high), energy


def energies(lens, setting, given, chosen):
    """Energy of each cause beyond the base model and the directions of the other causes."""
    start = respond(setting.world, given)
    signals = [lens.whiten(respond(fault.apply(setting.world, size), given) - start) for fault, size in chosen]
    result = []
    for index, signal in enumerate(signals):
        others = [lens.columns(fault.handles) for k, (fault, _) in enumerate(chosen) if k != index]
        result.append(lens.remains(signal, np.concatenate(others, axis=1) if others else None))
    return tuple(result)
