"""How far motions are closed by shooting: those that boxes show, those kept, and finalists."""

from __future__ import annotations

import dataclasses

from drake_aigto.shooting import ShootingOptions, Smoothing

# What boxes show is closed in a few steps: from walls smoothed by more, it takes longer and ends
# within 1 % of the best half as often (of 800 boxes around the cart-pole, `cart_pole/soft_06`).
COARSE = ShootingOptions(
    rungs=(Smoothing(1e-2, 8, 5e-2), Smoothing(1e-3, 15, 1e-2)), order=2, multiplier_updates=0
)

# Hard goals take more: closed as above, no motion that was kept led to the goal in four of 16
# questions about the cart-pole between soft walls; in none so.
AIMED = dataclasses.replace(COARSE, multiplier_updates=2)

# What a motion costs in short time steps, and then what walls that are hardly smoothed make of it:
# more smoothed, they push otherwise by as much as hard goals allow.
TIGHT = ShootingOptions(rungs=(Smoothing(1e-3, 40, 1e-3),), substeps=4)
POLISH = ShootingOptions(rungs=(Smoothing(1e-4, 40, 1e-5), Smoothing(1e-6, 40, 1e-5)), substeps=4)

# Friction stiffens from stiction speeds of a whole way in the duration to a thousandth.
COOLING = ShootingOptions(
    rungs=tuple(Smoothing(each, 60, 1e-5) for each in (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)),
    substeps=4,
)
