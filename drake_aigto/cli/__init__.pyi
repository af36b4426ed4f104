from .command_line import main as main
from .command_line import make_parser as make_parser
from .flags import BAD_INPUT as BAD_INPUT
from .flags import FAULT as FAULT
from .flags import FINE as FINE
from .flags import INTERRUPTED as INTERRUPTED
from .flags import NOTHING_HOLDS as NOTHING_HOLDS
from .flags import UNREAD as UNREAD
from .flags import add_workers as add_workers
from .flags import load_scenario as load_scenario
from .flags import read_workers as read_workers

__all__: list[str]
