"""Our own judge: exact laws of contact, by the quickest of four simulations that can."""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw, contact_law
from drake_aigto.simulation.parabolas import Flights, Parabolas
from drake_aigto.simulation.recording import Controller, HeldControl, Recording
from drake_aigto.simulation.rigid import RigidMotion, SlidingMotion
from drake_aigto.simulation.springs import SpringMotion
from drake_aigto.world import Scenario, World


class EventDriven:
    """Simulates walls that are rigid or compliant as the scenario says, exactly (a `Judge`).

    Where flight under a held control is a parabola (`World.constant_dynamics`) it is exact but for
    rounding, by roots alone (`Parabolas`, `Flights`); only hops too short to follow become rest.
    Elsewhere it is integrated nearly to rounding (`RigidMotion` has the equations), and so it is
    with friction (`SlidingMotion`): what sticks, slips or rolls, and until when, is found by roots,
    too. Compliant walls are springs that may be entered (`SpringMotion`).
    """

    def simulate(
        self,
        world: World,
        scenario: Scenario,
        controller: Controller,
        state: tuple[Floats, Floats] | None = None,
    ) -> Recording:
        """Runs a controller from the scenario's start, or from another state (q, v).

        Raises:
            TrajectoryError: the motion runs away to infinity.
            FrictionError: friction leaves no way to go on, or several (`find_modes`).
        """
        law, span = contact_law(world, scenario), (controller.start, controller.end)
        start = state or (scenario.initial_position, scenario.initial_velocity)
        if isinstance(law, CompliantLaw):
            recording = SpringMotion(world, law, start, controller.start).run(controller)
            recording.simulator = "integrated"
            return recording
        is_parabola = world.has_constant_dynamics and not law.has_friction
        if is_parabola and isinstance(controller, HeldControl) and controller.is_open_loop:
            flights = Parabolas(world.constant_dynamics, law.restitution, start, controller.times)
            recording = flights.record(controller.controls)
        else:
            kind = Flights if is_parabola else SlidingMotion if law.has_friction else RigidMotion
            recording = kind(world, law, start, span).run(controller)
        recording.simulator = "event-driven"
        return recording
