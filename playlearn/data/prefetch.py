"""Batches prepared in a thread, ahead of their use."""

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress


def prepared_ahead[T](make: Callable[[int], T], start_step: int) -> Iterator[T]:
    """make(start_step), make(start_step + 1), ... prepared in a thread that ends when the iterator is closed."""
    ready: queue.Queue[T | BaseException] = queue.Queue(maxsize=2)
    stop = threading.Event()

    def hand(item: T | BaseException) -> None:
        while not stop.is_set():
            with suppress(queue.Full):
                ready.put(item, timeout=0.1)
                return

    def prepare() -> None:
        step = start_step
        try:
            while not stop.is_set():
                hand(make(step))
                step += 1
        except BaseException as error:  # noqa: BLE001 - raised again where the batches are used
            hand(error)

    thread = threading.Thread(target=prepare, name="batches", daemon=True)
    thread.start()
    try:
        while True:
            item = ready.get()
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stop.set()
        thread.join()
