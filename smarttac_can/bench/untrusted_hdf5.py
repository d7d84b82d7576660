"""Read an HDF5 file of which nobody knows who made it.

HDF5 can do much that a file of measurements does not need, and that a file from elsewhere must not
do. Here only plain datasets are read:

* **No other file.** External storage, virtual datasets, external and soft links name files by their
  path: a dataset then has the content of any file of the user, or of a pipe that never ends.
* **No program.** A filter that is not of HDF5 itself is loaded as a plug-in.
* **No more than the file holds.** Hard links give one dataset many names, several rows may share
  one text, and chunks may share their bytes. So each dataset is read once, all storage and all
  texts together are not larger than the file, and no dataset is larger than deflate can restore.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import h5py

_MOST_COMPRESSED: Final = 1100
"""Most bytes that deflate restores from one byte."""
_MOST_CHUNK_BYTES: Final = 1 << 24
"""Most bytes of a chunk, which is restored as a whole even for one element."""
_TEXT_BYTES: Final = 1 << 26
"""Most bytes of texts that are read at a time."""
_MOST_NUMBER_BYTES: Final = 8
_KINDS: Final[Mapping[type, str]] = {int: "iu", float: "f", str: "OS"}
_Row = TypeVar("_Row", bound=NamedTuple)


class UntrustedFile:
    """Contents of an HDF5 file, each of which may be read once.

    Parameters
    ----------
    file
        Open file.
    size
        Its size in bytes.
    """

    def __init__(self, file: h5py.File, size: int) -> None:
        self._file = file
        self._size = size
        self._stored = self._texts = 0
        self._read: set[int] = set()

    def attributes(self, of: h5py.Dataset | None = None) -> dict[str, Any]:
        """Return the attributes of a dataset or of the file: single numbers and texts.

        Raises
        ------
        ValueError
            If an attribute is something else.
        """
        attrs = self._file.attrs if of is None else of.attrs
        found = {}
        for name in attrs:
            attribute = attrs.get_id(name)
            if attribute.shape != () or attribute.dtype.kind not in "biufOS":
                raise ValueError(f"attribute {name} is no number and no text")
            found[name] = self._plain(attrs[name])
        return found

    def dataset(self, name: str) -> h5py.Dataset:
        """Return the dataset with a name of its own in the file; raise as `members`."""
        return self._member(self._file, name)

    def members(self, group: str) -> Iterator[tuple[str, h5py.Dataset]]:
        """Yield names and datasets of a group; none if there is no such group.

        Raises
        ------
        KeyError, ValueError
            If it is missing, is no dataset, or is elsewhere.
        """
        import h5py  # noqa: PLC0415 - an extra, and slow

        if group in self._file:
            _require_here(self._file, group)
            of = self._file[group]
            if not isinstance(of, h5py.Group):
                raise ValueError(f"{group} is no group")
            for name in of:
                yield name, self._member(of, name)

    def numbers(self, data: h5py.Dataset, kinds: str = "iuf") -> npt.NDArray[Any]:
        """Return the elements of a dataset.

        Parameters
        ----------
        data
            Dataset of one dimension.
        kinds
            Kinds of numpy that its numbers may have.

        Raises
        ------
        ValueError
            If it has other elements or dimensions, or is larger than its file allows.
        """
        if data.dtype.kind not in kinds or data.dtype.itemsize > _MOST_NUMBER_BYTES:
            raise ValueError(f"{data.name} has elements of type {data.dtype}")
        self._require_plain(data)
        values: npt.NDArray[Any] = data[:]
        return values

    def table(self, data: h5py.Dataset, kind: type[_Row]) -> list[_Row]:
        """Return the rows of a table as named tuples; its columns are named like their fields.

        Raises
        ------
        ValueError
            If a column is missing or of another type, or as for `numbers`.
        """
        for name, hint in get_type_hints(kind).items():
            column = (data.dtype.fields or {}).get(name)
            if column is None or column[0].kind not in _KINDS[hint]:
                raise ValueError(f"{data.name} has no column {name} of type {hint.__name__}")
        self._require_plain(data)
        # A text is not larger than the file, but many rows may share it.
        step = max(1, _TEXT_BYTES // self._size)
        return [
            kind(*(self._plain(row[name]) for name in kind._fields))
            for begin in range(0, len(data), step)
            for row in data[begin : begin + step]
        ]

    def _member(self, group: h5py.Group, name: str) -> h5py.Dataset:
        import h5py  # noqa: PLC0415 - an extra, and slow

        _require_here(group, name)
        data = group[name]
        if not isinstance(data, h5py.Dataset):
            raise ValueError(f"{data.name} is no dataset")
        return data

    def _require_plain(self, data: h5py.Dataset) -> None:
        """Refuse a dataset that is elsewhere, needs a plug-in, was read, or is too large."""
        import h5py  # noqa: PLC0415 - an extra, and slow

        plan = data.id.get_create_plist()
        if plan.get_external_count() or data.is_virtual:
            raise ValueError(f"{data.name} is in another file")
        filters = {plan.get_filter(number)[0] for number in range(plan.get_nfilters())}
        if not filters <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}:
            raise ValueError(f"{data.name} has a filter other than deflate and shuffle")
        if data.ndim != 1:
            raise ValueError(f"{data.name} has {data.ndim} dimensions instead of 1")
        chunk = (data.chunks or (0,))[0] * data.dtype.itemsize
        if chunk > _MOST_CHUNK_BYTES:
            raise ValueError(f"{data.name} has chunks of {chunk} bytes, above {_MOST_CHUNK_BYTES}")
        address = h5py.h5o.get_info(data.id).addr
        if address in self._read:
            raise ValueError(f"{data.name} is the same dataset as another one")
        self._read.add(address)
        stored = data.id.get_storage_size()
        self._stored += stored
        if data.nbytes > _MOST_COMPRESSED * stored or self._stored > self._size:
            raise ValueError(f"{data.name} is too short for {data.size} elements")

    def _plain(self, value: Any) -> Any:
        """Return a value as a Python type: h5py gives texts as bytes, and numbers as numpy's."""
        if isinstance(value, str | bytes):
            self._texts += len(value)
            if self._texts > self._size:
                raise ValueError("its texts are longer than the file")
            return value.decode(errors="replace") if isinstance(value, bytes) else value
        if not isinstance(value, np.generic):
            raise ValueError(f"a value is of type {type(value).__name__}")
        return value.item()


def _require_here(group: h5py.Group, name: str) -> None:
    """Refuse a link to another file, or to a path that may be one."""
    import h5py  # noqa: PLC0415 - an extra, and slow

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is not in the file itself")
