"""Tables and plans as text: what has to be beside a cost is there, and all of it fits the page."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from drake_aigto.paper import Cell, Entry, RigidCell, RigidOptimum, Table1, TableMethod
from drake_aigto.planning import Candidate, Origin, Plan, Planner, Replays, Rung
from drake_aigto.show import cost_text, format_plan, format_replays, format_table1
from drake_aigto.simulation import PlannedContact, Replay
from drake_aigto.world import Scenario, World

WIDTH = 100


@pytest.fixture(scope="module")
def plan() -> Plan:
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=0.02)
    return Planner(scenario).plan()


def with_best(plan: Plan, best: Candidate) -> Plan:
    return dataclasses.replace(plan, candidates=(best, *plan.candidates[1:]))


def with_replays(plan: Plan, **changes: Any) -> Plan:
    """Returns the plan with the same fields of both replays changed."""
    rigid, drake = (dataclasses.replace(replay, **changes) for replay in plan.replay)
    return dataclasses.replace(plan, replay=Replays(rigid, drake))


def rigid_cell(plan: Plan, optimum: float, drake: bool = True) -> RigidCell:
    """Returns the cell of a plan whose replays cost 1 % more than 1e-4, and 1 % less."""
    rigid, compliant = plan.replay
    candidate = dataclasses.replace(
        plan.best, cost=1.00001e-4, replay=dataclasses.replace(rigid, cost=1.01e-4)
    )
    confirmed = dataclasses.replace(compliant, cost=0.99e-4) if drake else None
    entry = Entry("AIGTO, rigid", candidate, confirmed, True)
    method = TableMethod("AIGTO, rigid", (candidate.cost,), 1, (entry,), 0.5)
    return RigidCell(1, 0.8, RigidOptimum(optimum, (0.5123,), (-2.0,), 1.0), 1.2e-4, (method,))


def test_a_rigid_block_has_the_exact_optimum_and_how_far_above_it_all_is(plan: Plan) -> None:
    cell = rigid_cell(plan, optimum=1e-4)
    text = format_table1(Table1((), (cell,)))
    begin = text.splitlines().index("")
    title, costs, above = text.splitlines()[begin + 4 : begin + 7]
    assert title.startswith(
        "  rigid wall, e = 0.8; exact optimum 1.0000e-04, bounce at 0.512 s; "
        "Drake's wall 0.12 ms late ---"
    )
    assert re.fullmatch(
        r"  AIGTO, rigid .* 1\.0e-04 .* 0 m +1 1\.0e-04  0\.. mm 9\.9e-05 holds  0\.5", costs
    )
    assert re.fullmatch(r"  above the optimum +\+0\.001 % +\+1\.000 % +-1\.000 %", above)
    assert costs.index("1.0e-04") + len("1.0e-04") == above.index("%") + 1, "in one column"
    assert "Rigid transcription: 1 of 1 plans hold there." in text


def test_what_began_at_no_guess_of_the_solver_has_a_dash_before_its_cost(plan: Plan) -> None:
    best = dataclasses.replace(plan.best, start_cost=None, start_defects={})
    text = format_table1(Table1((), (rigid_cell(with_best(plan, best), optimum=1e-4),)))
    assert re.search(r"\n  AIGTO, rigid +- +1\.0e-04 ", text)


def test_what_has_no_optimum_or_no_drake_is_not_compared(plan: Plan) -> None:
    text = format_table1(Table1((), (rigid_cell(plan, optimum=1e-30),)))
    assert "exact optimum 0, bounce" in text
    assert re.search(r"\n  above the optimum +\+1\.0e-04 +\+1\.0e-04 +\+9\.9e-05\n", text)
    text = format_table1(Table1((), (rigid_cell(plan, optimum=1e-4, drake=False),)))
    block = text.split("\n\n")[1]
    assert "Drake's wall" not in block
    assert re.search(r"\n  above the optimum +\+0\.001 % +\+1\.000 %$", block)


def test_rounding_noise_is_not_shown_as_a_cost(plan: Plan) -> None:
    cell = rigid_cell(plan, optimum=1e-30, drake=False)
    (entry,) = cell.methods[0].entries
    noise = dataclasses.replace(
        entry.candidate, cost=7e-36, replay=dataclasses.replace(entry.candidate.replay, cost=3e-30)
    )
    method = dataclasses.replace(
        cell.methods[0], entries=(dataclasses.replace(entry, candidate=noise),)
    )
    text = format_table1(Table1((), (dataclasses.replace(cell, methods=(method,)),)))
    assert not re.search(r"e-3\d", text) and re.search(r"\n  above the optimum +0 +0\n", text)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_a_plan_shows_no_rounding_noise_at_any_scale(
    plan: Plan, world: World, scale: float
) -> None:
    scales = dataclasses.replace(plan.best.scales, cost=scale)
    noise, replay = 7e-20 * scale, dataclasses.replace(plan.best.replay, cost=3e-21 * scale)
    best = dataclasses.replace(plan.best, cost=noise, replay=replay, scales=scales)
    quiet = with_best(with_replays(plan, cost=-noise), best)
    lines = format_plan(quiet, world).splitlines()
    assert lines[2] == "cost        0, on a rigid wall 0, on Drake's plant 0"
    first = next(i for i, line in enumerate(lines) if "replayed" in line) + 1
    cells = lines[first].split()
    assert cells[0] == "0" and cells.count("0") >= 2
    assert sum("cost 0" in line for line in lines) >= 3
    loud = with_best(quiet, dataclasses.replace(best, cost=2e-6 * scale))
    assert f"cost {cost_text(2e-6 * scale, 3)}" in format_plan(loud, world)


def test_rows_show_the_literal_cells_before_the_rigid_one(plan: Plan) -> None:
    rigid = rigid_cell(plan, optimum=1e-4)
    entry = dataclasses.replace(rigid.methods[0].best, label="AIGTO, annealing", holds=False)
    method = dataclasses.replace(rigid.methods[0], entries=(entry,))
    literal = tuple(Cell(1, bound, (method,)) for bound in (False, True))
    text = format_table1(Table1(literal, (rigid,)))
    places = [
        text.index(f"\n  {title}") for title in ("φ free", "φ ≥ 0 at every knot", "rigid wall")
    ]
    assert places == sorted(places)
    assert "Literal transcription: 0 of 2 plans hold on a rigid wall." in text


@pytest.mark.parametrize("optimum", [1e-4, 3e-9, 1e-30, 5.0])
def test_no_line_of_the_table_is_too_long(plan: Plan, optimum: float) -> None:
    text = format_table1(Table1((), (rigid_cell(plan, optimum),)))
    assert max(map(len, text.splitlines())) <= WIDTH


def test_a_plan_begins_with_its_verdict_and_the_costs_that_it_rests_on(
    plan: Plan, world: World
) -> None:
    text = format_plan(plan, world)
    assert "pairs" not in text and "ball" not in text  # One wall needs no letters.
    verdict, _, costs = text.splitlines()[:3]
    assert verdict == (
        "verdict     holds: the control alone keeps the plan's promise on a rigid wall and on "
        "Drake's plant"
    )
    rigid, drake = plan.replay
    assert costs == (
        f"cost        {plan.cost:.3e}, on a rigid wall {rigid.cost:.3e}, "
        f"on Drake's plant {drake.cost:.3e}"
    )
    for told in (
        r"\nplan +rigid transcription, cost 2\.18.e-04, ends 0\.8 mm off the goal, ",
        r"\ndefects +flight .* m/s, contact \S+ m, restitution \S+ m/s, nonpenetration 0 m\n",
        r"\nfound by +boxes of \d+ steps, relaxation \S+\n",
    ):
        assert re.search(told, text), f"{told} in\n{text}"
    assert not re.search("[εδ]", text), "these are the literal transcription's"


@pytest.mark.parametrize(
    ("wrong", "where"),
    [
        ((True, True), "on a rigid wall and on Drake's plant"),
        ((True, False), "on a rigid wall"),
        ((False, True), "on Drake's plant"),
    ],
)
def test_a_failing_verdict_names_the_simulation(
    plan: Plan, world: World, wrong: tuple[bool, bool], where: str
) -> None:
    def spoil(replay: Replay, is_wrong: bool) -> Replay:
        return dataclasses.replace(replay, cost=1.0) if is_wrong else replay

    own, drake = (spoil(*pair) for pair in zip(plan.replay, wrong, strict=True))
    replays = Replays(own, drake)
    text = format_plan(dataclasses.replace(plan, replay=replays), world)
    assert text.startswith("verdict     fails: ")
    assert f" the control alone misses the plan's promise {where}\n" in text


def test_where_doing_nothing_ends_is_left_out_once_it_is_far_away(plan: Plan, world: World) -> None:
    assert plan.idle is not None
    assert "and ends 0.27 m off the goal\n" in format_replays(plan, world)
    gone = np.array([[1.0], [-15.0]])
    replay = dataclasses.replace(
        plan.idle.replay, times=np.ones(2), positions=gone, velocities=gone
    )
    idle = dataclasses.replace(plan.idle, replay=replay)
    others = tuple(each for each in plan.candidates if not each.is_idle)
    text = format_replays(dataclasses.replace(plan, candidates=(*others, idle)), world)
    assert "and flies or falls far away: no wall of the model stops it\n" in text


def test_what_is_not_known_is_left_out(plan: Plan, world: World) -> None:
    assert "ms late" in format_replays(plan, world)
    alone = dataclasses.replace(plan, replay=Replays(plan.replay.event_driven, None))
    assert "Drake" not in format_plan(alone, world)
    still = with_replays(
        plan, bounce_times=(), bounce_contacts=(), energies_before=(), energies_after=()
    )
    assert format_replays(still, world).count("no bounce") == 2
    assert "ms late" not in format_replays(still, world)


def test_what_compliance_explains_and_impacts_that_dissipation_matches_are_told(
    plan: Plan, world: World
) -> None:
    matched = with_replays(plan, matched_speeds=(1.234, 0.98765))
    assert "restitution matched for impacts at 1.23, 0.99 m/s" in format_plan(matched, world)
    told = format_replays(with_replays(plan, compliance_error=0.0034), world)
    assert told.count(" off the goal (its compliance explains 3.4 mm)") == 2
    rigid = with_replays(plan, compliance_error=0.0, compliance_cost=0.0)
    assert "compliance" not in format_replays(rigid, world)


def test_contacts_that_last_show_when_they_end(plan: Plan, world: World) -> None:
    contacts = (PlannedContact(0.25, 0.5, 3.0, 0.0), PlannedContact(0.75, 0.75, 1.5, 0.64))
    text = format_plan(with_best(plan, dataclasses.replace(plan.best, contacts=contacts)), world)
    assert "\ncontacts    0.250–0.500 s (Δv 3.00 m/s), 0.750 s (Δv 1.50 m/s),\n" in text
    assert re.search(r" mm  0\.250–0\.500, 0\.750 s\n", text)


@pytest.mark.parametrize("transcription", ["rigid", "literal"])
def test_no_line_of_a_plan_is_too_long(plan: Plan, world: World, transcription: str) -> None:
    contacts = tuple(PlannedContact(t, t + 0.01, 1e3, 1e9) for t in np.linspace(0, 99, 40))
    crowded = dataclasses.replace(
        plan.best,
        origin=Origin("x" * 200, Rung(1.0, {f"one weight {i}": 1.0 for i in range(30)})),
        contacts=contacts,
        cost=1.234e-100,
        defects={"a kind of row with a long name": 1e-300, **plan.best.defects},
    )
    busy = dataclasses.replace(plan, transcription=transcription, candidates=(crowded,) * 12)
    bounces = {"bounce_times": tuple(range(1000, 1400)), "bounce_contacts": (0,) * 400}
    text = format_plan(with_replays(busy, **bounces), world)
    assert max(map(len, text.splitlines())) <= WIDTH
    assert "and 4 more" in text
    assert "s and 394 more" in text
    # Touches without room beside their candidate are below it, none is cut off.
    assert "…" not in text and text.count("s and 34 more\n") == 8


def test_contacts_from_rest_are_said_to_be_so_and_have_no_energy_ratio(
    plan: Plan, world: World
) -> None:
    rest = (PlannedContact(0.25, 0.5, 3.0, None),)
    pushed = dataclasses.replace(plan.best, contacts=rest)
    text = format_plan(with_best(plan, pushed), world)
    assert "0.250–0.500 s (Δv 3.00 m/s), from rest\n" in text and "after / before" not in text
    both = dataclasses.replace(pushed, contacts=(*rest, PlannedContact(0.75, 0.75, 1.5, 0.64)))
    text = " ".join(format_plan(with_best(plan, both), world).split())
    assert "1 begins at rest, kinetic energy after / before 0.64" in text


@pytest.fixture(scope="module")
def corridor() -> World:
    return World.from_scenario(Scenario.named("corridor/three_bounces"))


def between_walls(plan: Plan) -> Plan:
    """Returns the plan as if it had three bounces between two walls."""
    contacts = tuple(
        PlannedContact(time, time, 4.0, 1.0, contact)
        for time, contact in ((0.15, 0), (0.66, 1), (1.18, 0))
    )
    bounces = {"bounce_times": (0.15, 0.66, 1.18), "bounce_contacts": (0, 1, 0)}
    told = with_replays(plan, **bounces, energies_before=(1.0,) * 3, energies_after=(1.0,) * 3)
    elsewhere = dataclasses.replace(told, world=None)
    return with_best(elsewhere, dataclasses.replace(plan.best, contacts=contacts))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Takes any world for that of a plan: these plans were made in none."""
    monkeypatch.setattr(Plan, "find_world", lambda plan, world: world)


@pytest.mark.usefixtures("made_up")
def test_contacts_between_several_walls_say_which(plan: Plan, corridor: World) -> None:
    text = format_plan(between_walls(plan), corridor)
    assert text.startswith(
        "verdict     holds: the control alone keeps the plan's promise on rigid w"
    )
    for told in (
        "\npairs       a ball against left wall, b ball against right wall\n",
        "\ncontacts    ball against left wall at 0.150 s (Δv 4.00 m/s),",
        "\n            ball against right wall at 0.660 s (Δv 4.00 m/s),",
        "bounces at a 0.1500, b 0.6600, a 1.1800 s",
        "  aba at 0.150, 0.660, 1.180 s\n",
        "kinetic energy after / before 1 in all\n",
        "energy ratio 1 a bounce,",
        "each up to 0.10 ms late",
    ):
        assert told in text, f"{told} in\n{text}"
    assert max(map(len, text.splitlines())) <= WIDTH


@pytest.mark.usefixtures("made_up")
def test_a_models_own_restitution_is_told(plan: Plan, corridor: World) -> None:
    left, right = corridor.contacts
    dull = dataclasses.replace(
        corridor, contacts=(dataclasses.replace(left, restitution=0.5), right)
    )
    text = format_replays(between_walls(plan), dull)
    assert (
        "\npairs       a ball against left wall (restitution 0.5), b ball against right wall\n"
        in text
    )


@pytest.mark.usefixtures("made_up")
def test_letters_do_not_run_out(plan: Plan, corridor: World) -> None:
    many = dataclasses.replace(corridor, contacts=corridor.contacts * 14)
    last = dataclasses.replace(plan.best, contacts=(PlannedContact(0.5, 0.5, 1.0, 1.0, 27),))
    alone = Replays(plan.replay.event_driven, None)
    text = format_plan(dataclasses.replace(with_best(plan, last), replay=alone), many)
    assert "b1 ball against right wall" in text and "  b1 at 0.500 s\n" in text
