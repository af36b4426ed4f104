"""How `AigoSolver` solves: numerics only."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from drake_aigto.errors import OptionsError

PolishName = Literal["newton", "ipopt", "snopt", "none"]


@dataclass(frozen=True, kw_only=True)
class AigoOptions:
    """Options of `AigoSolver`; each may also be set in SolverOptions under its name.

        options = SolverOptions()
        options.SetOption(AigoSolver.id(), "rounds", 20)

    Attributes:
        polish: the local solver that improves every box center on the true constraints: "newton"
            (`local.InteriorPoint`), "ipopt" or "snopt" through Drake, or "none".
        rounds: the most rounds in which boxes of some variables are renewed (`aigo.BoxSearch`).
            With constraints, they are shared out to three weights of their penalties. Also the most
            ladders of penalties, where there are stages or complementarities; a climb by interior
            points, where complementarities share a side, counts as three.
        patience: rounds in a row without a better point that end the search; with constraints, a
            sixth of them does at each weight; with ladders, three eighths of them do, and what is
            kept begins anew, until it led to the best cost twice, and eight ladders did, unless
            interior points climb too.
        feasibility: the largest violation of a constraint in an answer that is called a solution
            (`AigoDetails.violation`).
        first_half_width: half width of the first box where a variable has no bounds, relative to
            max(1, |guess|); it doubles from there while that lowers the cost's mean.
        max_doublings: how often it does so at most.
        starts: how many points, spread over the first box, are polished too; of programs with more
            than 30 variables, none.
        decades: where variables have no bounds, as many points again are spread beyond the first
            box and polished, up to its half width times 10 to this power; farther, as long as that
            leads to lower ones. 0: none.
        certify: whether a lower bound of the cost is found too (`drake_aigto.certify`): it ends the
            search once it proves the answer, and bounds what is searched.
        cells: the most cells that bounds are taken of.
        presolve: whether variables that an equality defines are substituted.
        seed: of everything random.
    """

    polish: PolishName = "newton"
    rounds: int = 200
    patience: int = 80
    feasibility: float = 1e-6
    first_half_width: float = 1.0
    max_doublings: int = 10
    starts: int = 20
    decades: int = 6
    certify: bool = False
    cells: int = 500_000
    presolve: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks the choices and ranges."""
        if self.polish not in (known := get_args(PolishName)):
            expected = f"one of {', '.join(known)}"
            raise OptionsError("polish", got=repr(self.polish), expected=expected)
        for name in ("feasibility", "first_half_width"):
            if not 0 < (value := getattr(self, name)) < float("inf"):
                raise OptionsError(name, got=value, expected="a number above 0")
        for name, least in (
            ("rounds", 0),
            ("patience", 1),
            ("max_doublings", 0),
            ("starts", 0),
            ("decades", 0),
            ("cells", 1),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if value != int(value) or value < least:
                raise OptionsError(name, got=value, expected=f"a whole number, {least} or more")

    def with_solver_options(self, values: Mapping[str, Any]) -> AigoOptions:
        """Returns these options with those replaced that Drake's SolverOptions name.

        Raises:
            OptionsError: an unknown name, or a value out of range.
        """
        known = [field.name for field in dataclasses.fields(self)]
        for name in values:
            if name not in known:
                raise OptionsError(
                    f"unknown option {name!r} of AigoSolver", expected=f"one of {', '.join(known)}"
                )
        return dataclasses.replace(self, **values)
