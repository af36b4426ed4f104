"""How far does single shooting get? Terms of states as polynomials of the controls, and a plan.

    python -m benchmarks.single_shooting

Prints how many terms a state has after each step, without contact and with polynomial laws of
several degrees in place of ε/(φ + δ), and how near those are to it for the paper's δ. Then plans
with as many steps as can be had, and beside it with states as variables.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_aigto.aigo import Annealing, Box, EqualWidths, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.paper import LiteralProblem, PolynomialLaw, SingleShooting, count_terms
from drake_aigto.terms import parse_costs
from drake_aigto.world import Scenario, World

DEGREES, REACH = (1, 2, 3, 4), 1.0
NEARER = (*DEGREES, 10, 20, 30)
PAPER = Scenario.named("table1/1")
# A wall that pushes from so far that a law of degree 2 is not too bad.
SOFT = dataclasses.replace(PAPER, initial_velocity=-3.0, epsilon=1.0, delta=0.2)


def with_steps(scenario: Scenario, number: int) -> Scenario:
    """Returns a scenario with other time steps."""
    return dataclasses.replace(scenario, time_step=scenario.duration / number)


def print_growth(world: World) -> None:
    """Prints how many terms states have."""
    scenario = with_steps(SOFT, 12)
    print("terms of a state after 1, 2, … steps")
    print("  without contact:", *count_terms(world, scenario))
    for degree in DEGREES:
        counts = count_terms(world, scenario, PolynomialLaw.fit(scenario, degree, REACH))
        print(f"  law of degree {degree}:", *counts, "" if len(counts) == 12 else "(refused)")
    print("largest error of laws over 1 m, in parts of λ(0)")
    for name, each in (("δ = 1 mm", PAPER), ("δ = 0.2 m", SOFT)):
        largest = each.epsilon / each.delta
        laws = [PolynomialLaw.fit(each, degree, REACH) for degree in NEARER]
        errors = [f"{law.largest_error(each, REACH) / largest:.2g}" for law in laws]
        print(f"  {name}, degrees {NEARER}:", *errors)


def print_plan(world: World, number: int) -> None:
    """Prints what AIGO and Newton's method make of it, and the same with states as variables."""
    scenario = with_steps(SOFT, number)
    shooting = SingleShooting(world, scenario, PolynomialLaw.fit(scenario, 2, REACH))
    prog = shooting.prog()
    f = BoxPolynomial(prog.num_vars(), parse_costs(prog))
    boxes = minimize(f, Box(*shooting.initial_box()), Annealing(initial_temperature=1e-2))
    points = EqualWidths(first_share=0.0, final_share=0.0, max_newton_steps=200)
    center = boxes.box.center
    x = minimize(f, Box(center, np.ones_like(center)), points).box.center
    rows = shooting.multiple_shooting
    problem = LiteralProblem(rows)
    y = problem.solve_locally(rows.initial_box()[0])
    print(
        f"{number} steps, degree 2: {f.num_terms:,} terms of {f.num_variables} variables, J = "
        f"{shooting.scenario_cost(x):.9e}; states as variables: "
        f"{problem.polynomial.num_terms:,} terms of {problem.polynomial.num_variables}, J = "
        f"{rows.scenario_cost(y):.9e}"
    )


def main() -> None:
    """Prints all."""
    world = World.from_scenario(PAPER)
    print_growth(world)
    for number in (4, 6, 8, 9):
        try:
            print_plan(world, number)
        except UnsupportedTermError as error:
            print(f"{number} steps, degree 2: {error}")


if __name__ == "__main__":
    main()
