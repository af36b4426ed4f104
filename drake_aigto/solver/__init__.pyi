from .boxes import make_first_box as make_first_box
from .complementarity import are_shared as are_shared
from .complementarity import find_complementarities as find_complementarities
from .details import AigoDetails as AigoDetails
from .details import AigoOptions as AigoOptions
from .details import AigoStatus as AigoStatus
from .lift import lift as lift
from .presolve import presolve as presolve
from .program import AigoProgram as AigoProgram
from .program import ContradictionError as ContradictionError
from .program import read_program as read_program
from .ranges import tighten as tighten
from .signs import interval as interval
from .signs import is_above as is_above
from .solver import AigoSolver as AigoSolver
from .staged import StagedProgram as StagedProgram
from .staged import find_quantities as find_quantities

__all__: list[str]
