"""Units on a Dask cluster: any number of workers, on this machine or on others.

Dask is an optional extra, ``pip install 'mcrim-mitsuba[cluster]'``.
"""

from __future__ import annotations

import json
import logging
import threading
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_text
from mcrim_mitsuba.runs import executors
from mcrim_mitsuba.runs.cache import other_version, record_versions
from mcrim_mitsuba.runs.executors import Contents

if TYPE_CHECKING:
    from distributed import Client

#: Seconds within which a scheduler must answer.
ANSWER_S = 10.0
#: How often a scheduler is asked: Dask's client may fail by itself while the machine is busy.
CONNECT_TRIES = 3
#: Units that are handed out ahead, per thread of the workers.
AHEAD = 3
#: How many these are at least.
LEAST_AHEAD = 8
_FILE = "name the one that dask scheduler writes"
_START = "start one with `dask scheduler`, and give its address, such as tcp://host:8786"
_LARGEST_MB = 1
_one_at_a_time = threading.Lock()


def connect(address: str) -> Client:
    """A client of a Dask scheduler.

    Its address is such as ``tcp://host:8786``, or the JSON file that ``dask scheduler
    --scheduler-file`` writes. Raises InputError if Dask is not installed, or no scheduler answers.
    """
    try:
        import distributed
    except ImportError:
        problem = "--cluster needs Dask, which is not installed"
        raise InputError(problem, "pip install 'mcrim-mitsuba[cluster]'") from None
    # of a connection that is lost we say ourselves what is to be said
    for name in ("distributed", "distributed.client"):  # the latter has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    file = Path(address)
    if file.suffix == ".json":
        if not file.is_file():
            raise InputError("there is no such file", _FILE, path=file)
        try:
            address = str(json.loads(read_text(file, _LARGEST_MB))["address"])
        except (ValueError, LookupError, TypeError, RecursionError):
            raise InputError("this is no file of a scheduler", _FILE, path=file) from None
    try:
        # a client of what is no address would wait, and complain at its end
        distributed.comm.get_address_host_port(address)
    except ValueError as error:
        raise InputError(f"no Dask scheduler answers at {address} ({error})", _START) from None
    for _ in range(CONNECT_TRIES):
        answer = _client_of(address)
        try:
            # Dask's own limit does not hold for what takes the connection and says nothing
            return answer.result(2 * ANSWER_S)
        except Exception as error:  # of many kinds, from sockets to assertions in Dask's client
            why = "what listens there says nothing"
            if answer.done():
                why = (str(error).strip() or type(error).__name__).splitlines()[0]
            if isinstance(error, OSError):  # nobody answered within ANSWER_S, Dask's own tries too
                break
    raise InputError(f"no Dask scheduler answers at {address} ({why})", _START)


def _client_of(address: str) -> Future[Client]:
    """A client of the scheduler at an address, when it is there, or what Dask's client raises."""
    import distributed

    answer: Future[Client] = Future()

    def ask() -> None:
        try:
            # as Dask's default it would be asked by xarray, too, even when it is lost
            client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
            answer.set_result(client)
        except Exception as error:
            answer.set_exception(error)

    threading.Thread(target=ask, daemon=True).start()
    return answer


class ClusterExecutor(executors.PoolExecutor):
    """Hands units to the workers of a Dask cluster (see `connect`), and keeps what comes back."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._client = connect(address)
        self._pool: Any = None

    @property
    def workers(self) -> dict[str, Any]:
        """Those that there are now, by address; more may come."""
        try:
            return dict(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, KeyError):  # a client that has given up knows nothing
            raise _lost(self._address) from None

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close()

    def ahead(self) -> int:
        threads = sum(worker["nthreads"] for worker in self.workers.values())
        return max(LEAST_AHEAD, AHEAD * threads)

    def submit(self, unit: executors.WorkItem) -> Future[Contents]:
        import distributed

        sent = executors.pickled(unit.portable())
        versions = record_versions(unit.variant, *unit.modules)
        try:
            self._pool = self._pool or self._client.get_executor(pure=False)
            return self._pool.submit(_make_by_value, sent, versions)
        except distributed.client.ClosedClientError:
            raise _lost(self._address) from None

    def look(self, track: executors.Track, what: str) -> None:
        """Tell that there are no workers; a cluster that is gone is refused, see `_lost`."""
        if self._client.status != "running":
            raise _lost(self._address)
        if not self.workers:
            track.tell(what, f"no workers at {self._address} yet")

    def give_up(self) -> None:
        if self._client.status == "running":
            self._pool.shutdown(wait=False)
        self._pool = None

    def result(self, future: Future[Contents], job: executors.Job) -> Contents:
        """What a worker sent; what went wrong there is said as it would be said here."""
        import dask
        import distributed

        try:
            return future.result()
        except InputError:
            # a scene that is refused there is refused here too, with the lines of its own file
            job.unit.check(None)
            raise
        except distributed.scheduler.KilledWorker as error:
            deaths = int(dask.config.get("distributed.scheduler.allowed-failures", 3)) + 1
            raise InputError(
                f"one unit brought down {deaths} workers one after the other",
                f"look at the log of the last one ({error.last_worker.address}): often it has too "
                "little memory",
                path=self._address,
            ) from None
        except ModuleNotFoundError as error:
            problem = f"a worker has no module {error.name}"
            mend = "install the same mcrim-mitsuba, with the same Python, for all workers"
            raise InputError(problem, mend, path=self._address) from None
        except (OSError, CancelledError):
            raise _lost(self._address) from None


def _lost(address: str) -> InputError:
    mend = "what was finished is kept: start it again, and run the same command again"
    return InputError("the connection to the scheduler was lost", mend, path=address)


def _make_by_value(pickled: bytes, versions: dict[str, str]) -> Contents:
    """`make_on_worker`; a worker that has no such module says so, where else it would go away."""
    # not as a global: that would be sent by its name in a module
    from mcrim_mitsuba.runs.cluster import make_on_worker

    return make_on_worker(pickled, versions)


#: What is of no module that others have is sent as a whole, not by its name.
_make_by_value.__module__ = "__main__"


def make_on_worker(pickled: bytes, versions: dict[str, str]) -> Contents:
    """Make a unit that `pickled` gave, in a worker: Mitsuba is started here.

    Raises InputError if the worker has other versions than `record_versions` of whoever wants the
    unit: its digits would be others.
    """
    from distributed import get_worker

    worker = get_worker()
    wrong = other_version(versions)
    if wrong is not None:
        problem = f"the worker {worker.address} has {wrong[0]} {wrong[2]}, not {wrong[1]}"
        raise InputError(problem, "install the same versions for all workers and for the command")
    # Dr.Jit's threads are the process's: units of one worker go one after the other
    with _one_at_a_time:
        return executors.make_sent(pickled, worker.state.nthreads)
