"""Work side by side: jobs on processes of this machine, or on the workers of a Dask scheduler."""

from drake_aigto.jobs.jobs import Jobs, ProcessDiedError, open_jobs
from drake_aigto.jobs.workers import open_workers

__all__ = ["Jobs", "ProcessDiedError", "open_jobs", "open_workers"]
