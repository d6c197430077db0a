"""Items of work on the workers of a dask cluster, in the order of completion; lost workers cost only what they worked on.

At most a few items per worker are in flight, and the future of a finished item is released at once.  Every item carries what
its task needs, so nothing is lost with a worker but the items it had.  A worker that no longer responds is replaced.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import Any, Generic, NoReturn, TypeVar
from uuid import uuid4

from distributed import Client, Future, KilledWorker

from pipeline.errors import GyroscreenError, IncompleteError

from .cluster import local_workers
from .faults import LOSSES, Ending, Faults, Sign, TimeLimit, Try, after_exception, after_loss
from .heartbeats import Heartbeats
from .item_task import item_task

In = TypeVar("In")
Out = TypeVar("Out")

_IN_FLIGHT = 4
#: Time without a worker, or without the scheduler, after which the run stops [s]; a worker needs some seconds to start.
_PATIENCE_S = 45.0
#: A worker without a heartbeat for this time is stopped or isolated [s]; heartbeats come every second or so.
_SILENT_S = 60.0
_LOOK_S = 2.0
#: Time between two looks at the devices of unfinished items [s]: a bar that is drawn twice a second moves evenly.
_WATCH_S = 0.5
#: Waits for a result that is finished, together as long as a worker may be silent [s].
_WAITS_S = (1.0, 2.0, 4.0, 8.0, 15.0, 30.0)


def in_parallel(
    client: Client,
    function: Callable[[Any, In], Out],
    constant: Any,
    items: Sequence[In],
    patience_s: float = _PATIENCE_S,
) -> Iterator[Out]:
    """``function(constant, item)`` of every item, in the order of completion.

    Raises
    ------
    IncompleteError : no worker or no scheduler for ``patience_s`` seconds, or an item lost its worker repeatedly.
    """
    for _, result in _Dispatch(client, function, constant, items, None, None, patience_s).results():
        yield result


def guarded_in_parallel(
    client: Client,
    function: Callable[..., Out],
    constant: Any,
    items: Sequence[In],
    faults: Faults[In],
    limit_s: float | None = None,
    patience_s: float = _PATIENCE_S,
    watch: Callable[[int], None] | None = None,
) -> Iterator[tuple[In, Out]]:
    """``(item, function(constant, item, begin))`` of every item, or of its parts where workers were lost.

    Parameters
    ----------
    function : calls ``begin(device)`` before each device.
    faults : how items are divided and given up.
    limit_s : time limit of a device [s]; ``None``: 20 times the median, at least 60 s.
    watch : called every ``_WATCH_S`` with the number of devices that are done in the items that are not, once one has started.

    Raises
    ------
    IncompleteError : there was no worker or no scheduler for ``patience_s`` seconds.
    """
    dispatch = _Dispatch(client, function, constant, items, faults, TimeLimit(limit_s), patience_s, watch)
    yield from dispatch.results()


class _RecomputedError(Exception):
    """A result was lost with its worker; dask computes it again."""


class _Dispatch(Generic[In, Out]):
    """The state of one series of items."""

    def __init__(
        self,
        client: Client,
        function: Callable[..., Out],
        constant: Any,
        items: Sequence[In],
        faults: Faults[In] | None,
        limit: TimeLimit | None,
        patience_s: float,
        watch: Callable[[int], None] | None = None,
    ) -> None:
        self._watch_devices = watch
        self._client, self._function, self._constant = client, function, constant
        self._waiting, self._again = iter(items), deque[Try[In]]()
        self._faults, self._limit, self._patience_s = faults, limit, patience_s
        self._topic = f"gyroscreen-{uuid4().hex}"
        self._flight: dict[str, tuple[Try[In], Future[Any]]] = {}
        self._done: SimpleQueue[tuple[str, float]] = SimpleQueue()
        self._signs: dict[str, Sign] = {}
        self._heartbeats = Heartbeats()
        self._replaced: set[str] = set()
        self._alive = self._busy = time.monotonic()

    def results(self) -> Iterator[tuple[In, Out]]:
        if self._limit is not None:
            self._client.subscribe_topic(self._topic, self._sign)
        self._look()
        looked = time.monotonic()
        try:
            while self._fill():
                with suppress(Empty):
                    wait_s = _LOOK_S if self._watch_devices is None else _WATCH_S
                    found = self._finished(*self._done.get(timeout=wait_s))
                    if found is not None:
                        self._fill()
                        yield found
                self._show_devices()
                if time.monotonic() - looked >= _LOOK_S:
                    self._look()
                    looked = time.monotonic()
        finally:
            if self._limit is not None:
                with suppress(Exception):
                    self._client.unsubscribe_topic(self._topic)

    def _sign(self, event: tuple[float, dict[str, Any]]) -> None:
        message = event[1]
        self._signs[message["key"]] = Sign(message["key"], message["device"], message["limit"], time.monotonic())

    def _show_devices(self) -> None:
        """Tell ``watch`` how many devices are done in the items in flight."""
        if self._watch_devices is None or self._faults is None:
            return
        local, devices = local_workers(self._client), self._faults.devices
        signs = list(self._signs.values()) if local is None else local.signs()
        own = [(sign, self._flight[sign.key][0].item) for sign in signs if sign.key in self._flight]
        if own:
            self._watch_devices(sum(max(sign.device - devices(item).start, 0) for sign, item in own))

    def _fill(self) -> bool:
        """Submit items up to the number in flight; whether any are in flight or left."""
        while len(self._flight) < _IN_FLIGHT * max(len(self._heartbeats.last), 1):
            if self._again:
                tried = self._again.popleft()
            else:
                try:
                    tried = Try(next(self._waiting))
                except StopIteration:
                    break
            if self._client.status != "running":
                self._again.append(tried)
                return True
            self._submit(tried)
        return bool(self._flight)

    def _submit(self, tried: Try[In]) -> None:
        key = f"{self._function.__name__}-{uuid4().hex}"
        limit = None if self._limit is None else self._limit.now_s
        arguments = (self._function, self._constant, tried.item, key, self._topic, limit)
        future = self._client.submit(item_task, *arguments, key=key, pure=False)
        self._flight[key] = (tried, future)
        self._watch(key, future)

    def _watch(self, key: str, future: Future[Any]) -> None:
        future.add_done_callback(lambda _: self._done.put((key, time.monotonic())))

    def _finished(self, key: str, at: float) -> tuple[In, Out] | None:
        """The result of an item, or ``None`` if it or its parts must be tried again."""
        if key not in self._flight:
            return None  # it was submitted again in the meantime
        self._busy = time.monotonic()
        tried, future = self._flight[key]
        try:
            result, seconds = self._gathered(future)
        except _RecomputedError:
            self._watch(key, future)
            return None
        except KilledWorker as error:
            self._lost(tried, key, at, error)
        except (CancelledError, TimeoutError):
            # The scheduler was lost, or the worker after its last word: the item itself did nothing wrong.
            self._again.append(tried)
        except GyroscreenError:
            raise
        except Exception as error:
            if self._faults is None:
                raise
            self._again.extend(after_exception(tried, error, self._faults))
        else:
            if self._limit is not None:
                self._limit.seconds.extend(seconds)
            self._forget(key)
            return tried.item, result
        self._forget(key)
        return None

    def _forget(self, key: str) -> None:
        _, future = self._flight.pop(key)
        self._signs.pop(key, None)
        future.release()

    def _gathered(self, future: Future[Any]) -> Any:
        """The result of a finished future; its worker may have ended, or stopped, before the result was fetched."""
        # Each wait cancels the transfer under way when it ends: with waits of 1 s alone, a machine whose transfers took longer
        # computed the same blocks for ever (100 blocks computed, none committed).
        for wait_s in _WAITS_S:
            try:
                return future.result(timeout=wait_s)
            except (TimeoutError, UnboundLocalError):
                # distributed (2026.1) raises the latter where its own wait was cancelled at the time limit: it returns a result
                # that it has not set.  On a loaded machine this ended 2 of 3 studies of some hours.
                if future.status != "finished":
                    raise _RecomputedError from None
        raise TimeoutError

    def _lost(self, tried: Try[In], key: str, at: float, error: KilledWorker) -> None:
        worker, local = error.last_worker, local_workers(self._client)
        sign = self._signs.get(key) if local is None else local.sign(str(worker.name))
        sign = sign if sign is not None and sign.key == key else None
        ending = Ending() if local is None else local.ending(str(worker.name))
        if worker.address in self._replaced:
            # Four times as long would be longer than a device may take: it is tried alone at once, and given up at the next loss.
            tried, ending = replace(tried, losses=LOSSES - 1), Ending(f"no heartbeat for {_SILENT_S:g} s")
        if self._faults is not None:
            self._again.extend(after_loss(tried, sign, at, ending, self._faults))
        elif tried.losses < 2 * LOSSES:
            self._again.append(Try(tried.item, tried.losses + 1))
        else:
            raise IncompleteError(
                "an item of the work ended its worker repeatedly",
                value=str(tried.item)[:100],
                next_step="check the memory of the workers; repeat the command to continue",
            )

    def _look(self) -> None:
        """Look at the workers: replace those without a heartbeat, and stop if there is none left."""
        now = time.monotonic()
        seen: dict[str, float] = {}
        names: dict[str, str] = {}
        if self._client.status == "running":
            with suppress(OSError, RuntimeError, TimeoutError):
                workers = self._client.scheduler_info(n_workers=-1)["workers"]
                seen = {address: float(worker["last_seen"]) for address, worker in workers.items()}
                names = {address: str(worker["name"]) for address, worker in workers.items()}
                if any(worker["metrics"].get("task_counts", {}).get("executing") for worker in workers.values()):
                    self._busy = now
        self._heartbeats.look(seen, now)
        if seen:
            self._alive = now
            silent = {address: names[address] for address in self._heartbeats.silent(_SILENT_S)}
            if silent:
                self._replace(silent)
            elif now - self._busy > _SILENT_S:
                self._submit_again()
        elif now - self._alive > self._patience_s:
            self._stop()

    def _submit_again(self) -> None:
        """Submit all items in flight again: after 60 kills dask left two idle workers beside 8 items that it never sent them."""
        for key, (tried, _) in list(self._flight.items()):
            self._again.append(tried)
            self._forget(key)
        self._busy = time.monotonic()
        self._fill()

    def _replace(self, silent: Mapping[str, str]) -> None:
        """End the workers with these addresses and names; local ones, and those with a nanny, are started again."""
        self._replaced.update(silent)
        local, scheduler = local_workers(self._client), self._client.scheduler
        if local is not None:
            for name in silent.values():
                local.end(name)
        elif scheduler is not None:
            how = {"timeout": 30, "on_error": "return", "wait_for_workers": False}
            stimulus = f"silent-{uuid4().hex}"
            self._client.sync(scheduler.restart_workers, workers=list(silent), stimulus_id=stimulus, **how)

    def _stop(self) -> NoReturn:
        lost = self._client.status != "running"
        raise IncompleteError(
            "the connection to the dask scheduler is lost" if lost else "no worker is left",
            value=f"{self._patience_s:g} s without {'it' if lost else 'a worker'}",
            allowed="a scheduler that runs" if lost else "at least one worker",
            next_step="check the scheduler and the logs of the workers (memory), then continue: gyroscreen run --resume latest",
        )
