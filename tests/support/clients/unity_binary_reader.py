"""Reading the binary forms, for checks. Written from the format's description, not from the writer.

Strings split into shared parts, which this program never writes, are refused.
"""

from __future__ import annotations

from capture2vr.storage.unity.bounded import BoundedReader
from capture2vr.storage.unity.listing import BundleOptions, Listing, Location, TypeName

_MAGIC = 0x0DE38942
_NULL = 0xFFFFFFFF
_UNICODE, _SPLIT = 1 << 31, 1 << 30
_NAME_LIMIT = 1000  # letters of an assembly's or class's name; many types may share one, and each is cut anew
_CORE_LIBRARIES = ("mscorlib", "System.Private.CoreLib", "netstandard")


def read_binary_catalogue(data: bytes) -> Listing:
    """What a binary catalogue says. Raises ValueError that names the fault, whatever the bytes are."""
    file = _Reader(data)
    magic, version, keys_at, id_at = file.bytes.unpack("<4I", 0)
    if magic != _MAGIC:
        raise ValueError(f"not a binary catalogue: it begins with {magic:#010x} instead of {_MAGIC:#010x}")
    if not 1 <= version <= 3:
        raise ValueError(f"binary catalogue of version {version}; 1, 2 and 3 are known")
    pairs = file.array(keys_at)
    if len(pairs) % 2:
        raise ValueError(f"binary catalogue: the keys at {keys_at} are no pairs")
    keys = {file.string_object(key): places for key, places in zip(pairs[::2], pairs[1::2], strict=True)}
    if len(keys) < len(pairs) // 2:
        raise ValueError("binary catalogue: a key stands there twice")
    order = _reached(file, set(keys.values()))
    index = {place: number for number, place in enumerate(order)}
    sets = _Sets(file, index)
    locations = tuple(_location(file, place, sets) for place in order)
    return Listing(version, file.text(id_at), locations, {key: sets.at(places) for key, places in keys.items()})


def _reached(file: _Reader, sets: set[int]) -> list[int]:
    """Where the locations are that the sets lead to, directly or as dependencies, in the order of the file."""
    seen_sets, found = {_NULL}, set[int]()
    while sets:
        seen_sets |= sets
        new = {place for each in sets for place in file.array(each)} - found
        found |= new
        sets = {file.bytes.unpack("<4I", place)[3] for place in new} - seen_sets
    return sorted(found)


class _Sets:
    """Sets of locations as indices. Those at the same place are the same tuple, however many refer to it."""

    def __init__(self, file: _Reader, index: dict[int, int]) -> None:
        self._file, self._index = file, index
        self._known: dict[int, tuple[int, ...]] = {_NULL: ()}

    def at(self, offset: int) -> tuple[int, ...]:
        if offset not in self._known:
            self._known[offset] = tuple(self._index[place] for place in self._file.array(offset))
        return self._known[offset]


def _location(file: _Reader, place: int, sets: _Sets) -> Location:
    key, internal_id, provider, dependencies, _, data, type_at = file.bytes.unpack("<4Ii2I", place)
    return Location(
        key=file.text(key),
        internal_id=file.text(internal_id),
        provider=file.text(provider),
        type=file.type(type_at),
        data=file.data(data),
        dependencies=sets.at(dependencies),
    )


class _Reader:
    """The kinds of records, each by its offset."""

    def __init__(self, data: bytes) -> None:
        self.bytes = BoundedReader("binary catalogue", data)
        self._arrays: dict[int, tuple[int, ...]] = {}
        self._texts: dict[int, str] = {_NULL: ""}
        self._sizes: dict[int, int] = {}

    def array(self, offset: int) -> tuple[int, ...]:
        if offset not in self._arrays:
            size = self._block_size(offset)
            if size % 4:
                raise ValueError(f"binary catalogue: {size} bytes at {offset} are no whole numbers")
            self._arrays[offset] = self.bytes.unpack(f"<{size // 4}I", offset)
        return self._arrays[offset]

    def text(self, reference: int) -> str:
        if reference not in self._texts:
            if reference & _SPLIT:
                raise ValueError(f"binary catalogue: the string {reference:#x} is split, which is not supported")
            offset = reference & ~_UNICODE
            encoding = "utf-16-le" if reference & _UNICODE else "ascii"
            self._texts[reference] = self.bytes.text(offset, self._block_size(offset), encoding)
        return self._texts[reference]

    def type(self, offset: int) -> TypeName:
        assembly_at, name_at = self.bytes.unpack("<2I", offset)
        assembly, name = self.text(assembly_at), self.text(name_at)
        if max(len(assembly), len(name)) > _NAME_LIMIT:
            raise ValueError(f"binary catalogue: the type at {offset} has a name of more than {_NAME_LIMIT} letters")
        assembly = assembly.partition(",")[0]
        return TypeName("" if assembly in _CORE_LIBRARIES else assembly, name)

    def string_object(self, offset: int) -> str:
        data = self.data(offset)
        if not isinstance(data, str):
            raise ValueError(f"binary catalogue: the key at {offset} is no string")
        return data

    def data(self, offset: int) -> str | BundleOptions | None:
        """A typed object: a reference to its type, then one to itself."""
        if offset == _NULL:
            return None
        type_at, object_at = self.bytes.unpack("<2I", offset)
        name = self.type(type_at).name.rpartition(".")[2]
        if object_at == _NULL:
            return None
        if name == "String":
            return self.text(self.bytes.unpack("<I4x", object_at)[0])
        if name == "AssetBundleRequestOptions":
            return self._bundle_options(object_at)
        raise ValueError(f"binary catalogue: data of class {name!r} at {offset} is not supported")

    def _bundle_options(self, offset: int) -> BundleOptions:
        hash_at, name, crc, size, transfer_at = self.bytes.unpack("<5I", offset)
        self.bytes.unpack("<hBBi", transfer_at)
        return BundleOptions(self.bytes.take(hash_at, 16).hex(), crc, self.text(name), size)

    def _block_size(self, offset: int) -> int:
        if offset not in self._sizes:
            (size,) = self.bytes.unpack("<I", offset - 4)
            self.bytes.check(offset, size)
            self.bytes.spend(4 + size, offset)
            self._sizes[offset] = size
        return self._sizes[offset]
