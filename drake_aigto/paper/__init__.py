"""What the paper does, as it does it, and what simulations make of it (AIGTO Sec. III and IV)."""

from drake_aigto.paper.contact_law import PolynomialLaw
from drake_aigto.paper.gradient import gradient_from_random, gradient_from_zero, random_guess
from drake_aigto.paper.literal import LiteralTranscription
from drake_aigto.paper.options import LITERAL_LADDER, LiteralOptions
from drake_aigto.paper.planner import LiteralSearch, plan_literal
from drake_aigto.paper.problem import LiteralProblem, make_literal_problem
from drake_aigto.paper.single_shooting import SingleShooting, count_terms
from drake_aigto.paper.with_forces import LiteralWithForces, RigidWithForces

__all__ = [
    "LITERAL_LADDER",
    "LiteralOptions",
    "LiteralProblem",
    "LiteralSearch",
    "LiteralTranscription",
    "LiteralWithForces",
    "PolynomialLaw",
    "RigidWithForces",
    "SingleShooting",
    "count_terms",
    "gradient_from_random",
    "gradient_from_zero",
    "make_literal_problem",
    "plan_literal",
    "random_guess",
]
