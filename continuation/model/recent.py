"""The last values that were made, by key."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """A bounded memory: the value of a key is made once, and the oldest is dropped for a new one.

    Parameters
    ----------
    most : int
        Number of values that are kept.

    Examples
    --------
    >>> squares = Recent(2)
    >>> [squares.get(k, lambda k=k: k * k) for k in (3, 4, 3)], len(squares)
    ([9, 16, 9], 2)
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: dict[Hashable, T] = {}

    def __len__(self) -> int:
        return len(self._known)

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a key, made where it is not known."""
        if key not in self._known:
            self.put(key, make())
        return self._known[key]

    def put(self, key: Hashable, value: T) -> None:
        """Keep a value."""
        if len(self._known) >= self._most and key not in self._known:
            del self._known[next(iter(self._known))]
        self._known[key] = value

    def clear(self) -> None:
        """Forget everything."""
        self._known.clear()
