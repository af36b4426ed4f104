from .jobs import Jobs as Jobs
from .jobs import ProcessDiedError as ProcessDiedError
from .jobs import open_jobs as open_jobs
from .jobs import open_workers as open_workers
from .many import Answer as Answer
from .many import load_answers as load_answers
from .many import plan_many as plan_many

__all__: list[str]
