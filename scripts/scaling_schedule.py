"""How a cluster with any number of workers would get on: what happens when, from measured times.

The client is one process that does one thing at a time: it hands out a unit, or takes in a result
and keeps it. It hands out so many units ahead of the first one that is lacking, and stages that
depend on each other follow each other. The network and the scheduler take some time with each
unit, during which they do others too.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.work.cluster import AHEAD, LEAST_AHEAD


@dataclass(frozen=True)
class Times:
    """Measured times in seconds.

    Attributes
    ----------
    submit, gather : float
        Of the client for a unit: to pack and hand it out; to take in and keep its result.
    latency : float
        From the client to the worker and back, beside these.
    start : float
        Of a worker, before its first unit.
    """

    submit: float
    gather: float
    latency: float
    start: float


@dataclass(frozen=True)
class Schedule:
    """What came of it.

    Attributes
    ----------
    workers : int
    seconds : float
    busy : float
        Part of the workers' time in which they work on units.
    client : float
        Part of the time in which the client is at work.
    """

    workers: int
    seconds: float
    busy: float
    client: float


def schedule(workers: int, stages: Sequence[Sequence[float]], times: Times) -> Schedule:
    """Follow all units.

    Parameters
    ----------
    workers : int
        Of one thread each.
    stages : sequence of sequence of float
        Seconds of the units on a worker; a stage begins when the one before has ended.
    times : Times
    """
    now = client = 0.0
    free = [times.start] * workers  # when each worker can begin
    heapq.heapify(free)
    ahead = max(LEAST_AHEAD, AHEAD * workers)
    for units in stages:
        coming: list[tuple[float, int]] = []  # when results are there for the client
        gathered = np.zeros(len(units), bool)
        first = following = 0
        while first < len(units):
            if following < min(len(units), first + ahead):
                now += times.submit
                client += times.submit
                begin = max(heapq.heappop(free), now + times.latency / 2)
                end = begin + units[following]
                heapq.heappush(free, end)
                heapq.heappush(coming, (end + times.latency / 2, following))
                following += 1
                continue
            arrival, number = heapq.heappop(coming)
            now = max(now, arrival) + times.gather
            client += times.gather
            gathered[number] = True
            while first < len(units) and gathered[first]:
                first += 1
    worked = sum(map(sum, stages))
    return Schedule(workers, now, worked / (workers * now), client / now)


def limit(found: Schedule, units: int, times: Times, stages: int) -> str:
    """Why it is not faster, in words."""
    if found.busy > 0.85:
        return "the workers"
    if found.client > 0.85:
        return "the client, which takes in one result after the other"
    if times.start > 0.3 * found.seconds:
        return "the workers' start"
    if units / stages < 4 * found.workers:
        return "too few units of a stage for so many workers"
    return "waiting for the last units of each stage"
