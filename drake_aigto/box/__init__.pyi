from .functions import D_C as D_C
from .functions import D_CC as D_CC
from .functions import D_CZ as D_CZ
from .functions import D_Z as D_Z
from .functions import D_ZZ as D_ZZ
from .functions import VALUE as VALUE
from .functions import factor_mean as factor_mean
from .kernels import NO_SYSTEM as NO_SYSTEM
from .kernels import System as System
from .kernels import add_means as add_means
from .lanes import Lanes as Lanes
from .lanes import make_lanes as make_lanes
from .polynomial import BoxPolynomial as BoxPolynomial
from .polynomial import NewtonSystem as NewtonSystem
from .polynomial import ParametricPolynomial as ParametricPolynomial
from .tapes import Order as Order

__all__: list[str]
