"""CSV tables of transmission error or mesh stiffness over the mesh phase or a roll angle.

The first line that is neither blank nor a comment (``#``) is the header: columns separated by commas, semicolons or
tabs, each with its unit in brackets. The first column is ``phase [1]`` (one mesh cycle is 1), or ``pinion angle`` or
``gear angle`` (also ``pinion roll angle``) in ``[deg]`` or ``[rad]``. Every further column is one of

- ``loaded TE MEMBER TORQUE [unit]`` or ``unloaded TE MEMBER [unit]`` with an angle (``urad``, ``arcsec``) or an arc on
  the mean pitch circle (``um``) of the ``pinion`` or the ``gear``, or a distance along the ``normal`` of the mesh;
- ``stiffness TORQUE [N/um]`` or ``[N/m]``, along the normal.

TORQUE, such as ``300 N m``, is on the member that ``[load]`` of the pair names. It may be left out where a table has
one loaded column, which then is at the torque of the pair. Errors are positive when the gear lags behind the pinion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sbg_casadi.errors import PairError
from sbg_casadi.table_heads import EXAMPLE, Member, Quantity, read_first, read_further

LARGEST = 20_000_000  # bytes of a table
_MOST = 1e15  # of any number, in the unit of its column


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Hold one column of values.

    Attributes
    ----------
    quantity : {"loaded TE", "unloaded TE", "stiffness"}
    member : {"pinion", "gear", "normal"}
        What a transmission error is measured on; ``"normal"`` for a stiffness.
    angular : bool
        True for values in rad, False for m or N/m.
    torque : float or None
        N m; None when the header gives none.
    values : numpy.ndarray, shape (samples,)
        In SI units.
    """

    quantity: Quantity
    member: Member
    angular: bool
    torque: float | None
    values: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTable:
    """Hold a table as read, in SI units.

    Attributes
    ----------
    place : str
        Beginning of every message about the table, names the file.
    abscissa : {"phase", "pinion", "gear"}
        Mesh phase in cycles, or roll angle of a member in rad.
    positions : numpy.ndarray, shape (samples,)
        First column, increasing.
    lines : numpy.ndarray of int, shape (samples,)
        Line of the file of each sample.
    columns : tuple of Column
        The further columns.
    """

    place: str
    abscissa: Literal["phase", "pinion", "gear"]
    positions: np.ndarray
    lines: np.ndarray
    columns: tuple[Column, ...]

    def of(self, quantity: Quantity) -> list[Column]:
        """Return the columns of a quantity in the order of the file."""
        return [column for column in self.columns if column.quantity == quantity]

    def cycles(self, teeth: tuple[int, int] | None) -> np.ndarray:
        """Return the first column in mesh cycles; roll angles need the teeth of pinion and gear.

        Raises
        ------
        PairError
            If the column is a roll angle and there are no teeth.
        """
        if self.abscissa == "phase":
            return self.positions
        if teeth is None:
            raise PairError(f"{self.place} is over a roll angle, which needs the teeth of a pair; expected phase [1]")
        return self.positions * teeth[0 if self.abscissa == "pinion" else 1] / (2 * math.pi)


def read_table(path: Path) -> MeasuredTable:
    """Read a CSV file; see the head of this module for its columns.

    Raises
    ------
    PairError
        With one sentence that names the file and the line.
    """
    place = f"table {str(path)!r}"
    try:
        with open(path, "rb") as stream:
            data = stream.read(LARGEST + 1)
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise PairError(f"{place} is not UTF-8 text (byte {error.start}); expected a CSV file in UTF-8") from None
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or str(error)
        raise PairError(f"{place} can't be read: {reason}; expected a CSV file") from None
    if len(data) > LARGEST:
        raise PairError(f"{place} is larger than {LARGEST} bytes; expected a table of mesh cycles")
    return parse_table(text, place)


def parse_table(text: str, place: str = "table") -> MeasuredTable:
    """Read the text of a table.

    Parameters
    ----------
    text : str
        The whole file.
    place : str
        Beginning of every message.

    Raises
    ------
    PairError
        If the header or a number can't be read, or the first column does not increase.

    Examples
    --------
    >>> table = parse_table("# measured\\nphase [1], stiffness [N/um]\\n0, 500\\n0.5, 420 # valley\\n1, 500\\n")
    >>> table.columns[0].values.tolist(), table.lines.tolist()
    ([500000000.0, 420000000.0, 500000000.0], [3, 4, 5])
    """
    lines = [(n, part) for n, line in enumerate(text.splitlines(), 1) if (part := line.split("#", 1)[0].strip())]
    if not lines:
        raise PairError(f"{place} is empty; expected a header such as '{EXAMPLE}'")
    number, header = lines[0]
    separator = next((s for s in (";", "\t") if s in header), ",")
    titles = [title.strip() for title in header.split(separator)]
    where = f"{place}, line {number}"
    abscissa, scale = read_first(titles[0], where)
    if len(titles) < 2:
        raise PairError(f"{where}: one column only; expected a header such as '{EXAMPLE}'")
    heads = [read_further(title, where) for title in titles[1:]]
    rows = np.array([_numbers(line, separator, len(titles), f"{place}, line {n}") for n, line in lines[1:]])
    if len(rows) < 3:
        raise PairError(f"{place} holds {len(rows)} rows of numbers; expected at least 3 over whole mesh cycles")
    numbers = np.array([n for n, _ in lines[1:]])
    back = np.flatnonzero(np.diff(rows[:, 0]) <= 0)
    if back.size:
        i = int(back[0]) + 1
        raise PairError(
            f"{place}, line {numbers[i]}: {titles[0]} = {rows[i, 0]:.9g} after {rows[i - 1, 0]:.9g}; expected an "
            "increasing first column"
        )
    columns = tuple(
        Column(head.quantity, head.member, head.angular, head.torque, rows[:, i] * head.scale)
        for i, head in enumerate(heads, 1)
    )
    return MeasuredTable(place, abscissa, rows[:, 0] * scale, numbers, columns)


def _numbers(line: str, separator: str, count: int, where: str) -> list[float]:
    parts = [part.strip() for part in line.split(separator)]
    if len(parts) != count:
        raise PairError(f"{where}: {len(parts)} values; expected {count}, one for each column")
    values = []
    for part in parts:
        try:
            values.append(float(part))
        except ValueError:
            raise PairError(f"{where}: {part[:30]!r} is not a number; expected such as 0.125") from None
        if not abs(values[-1]) <= _MOST:
            raise PairError(f"{where}: {part[:30]!r} is not finite or too large; expected such as 0.125")
    return values
