"""Long jobs as units of work: each depends on what it says itself, and is kept when it is done.

Who does the units is the crew's business: this process, a Dask cluster, or one process of an
array job. Results do not depend on it.
"""

from mcrim_mitsuba.work.crew import Crew, Done, current_crew, use_crew
from mcrim_mitsuba.work.progress import Progress
from mcrim_mitsuba.work.unit import Content, Task, Unit

__all__ = ["Content", "Crew", "Done", "Progress", "Task", "Unit", "current_crew", "use_crew"]
