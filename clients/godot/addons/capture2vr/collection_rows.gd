extends RefCounted
## Reads the rows of a collection from its tree: for one asset a single object of each level, for a list in order of the keys
## as many as are asked for.

const CollectionIndex := preload("collection_index.gd")
const Fetcher := preload("fetcher.gd")

const TOGETHER := 16  # are read at a time; fewer of them are downloads

var _collection: String
var _fetch: Node
var _load: Callable


## load_part: returns the bytes of a part, checked by their hash, or a CaptureFault; awaited. fetch: a node that goes when
## the collection does.
func _init(collection: String, fetch: Node, load_part: Callable) -> void:
	_collection = collection
	_fetch = fetch
	_load = load_part


## The row of an asset, null where there is none, or a CaptureFault.
func find(index: CollectionIndex, key: String) -> Variant:
	var parts: Array = index.parts
	for depth in range(index.depth, 0, -1):
		var node := _place(parts, key)
		var below: Variant = [] if node == null else await _read(node, depth)
		if below is CaptureFault:
			return below
		parts = below
	var shard := _place(parts, key)
	var rows: Variant = {} if shard == null else await _read(shard, 0)
	return rows if rows is CaptureFault else rows.get(key)


## The rows behind a key, at most so many, or a CaptureFault; what was removed is left out. most: -1 for all.
func list(index: CollectionIndex, after: String, most: int) -> Variant:
	var found: Array[CaptureRow] = []
	var fault := await _walk(index.parts, index.depth, after, most, found)
	return found if fault == null else fault


func _walk(parts: Array, depth: int, after: String, most: int, found: Array[CaptureRow]) -> CaptureFault:
	var left := parts.filter(func(part: CollectionIndex.Part) -> bool: return part.last > after)
	while not left.is_empty() and (most < 0 or found.size() < most):
		for content: Variant in await _read_all(_first(left, -1 if most < 0 else most - found.size()), depth):
			if content is CaptureFault:
				return content
			var fault: CaptureFault = null
			if depth > 0:
				fault = await _walk(content, depth - 1, after, most, found)
			else:
				_take(content, after, most, found)
			if fault != null:
				return fault
	return null


## Take the parts off a list that are to be read together: as many as have the rows that are still asked for.
static func _first(left: Array, rows: int) -> Array:
	var batch := []
	var sum := 0
	while not left.is_empty() and batch.size() < TOGETHER and (rows < 0 or sum < rows):
		sum += left[0].count
		batch.append(left.pop_front())
	return batch


static func _take(rows: Dictionary, after: String, most: int, found: Array[CaptureRow]) -> void:
	for row: CaptureRow in rows.values():
		if row.key > after and not row.removed and (most < 0 or found.size() < most):
			found.append(row)


## The last part that begins with the key or before it, else the first; null where there is none.
static func _place(parts: Array, key: String) -> CollectionIndex.Part:
	var found: CollectionIndex.Part = null
	for part: CollectionIndex.Part in parts:
		if found == null or part.first <= key:
			found = part
	return found


## What each of some parts holds, in their order, or a CaptureFault in its place.
func _read_all(parts: Array, depth: int) -> Array:
	var results := []
	results.resize(parts.size())
	results.fill(CaptureFault.new(CaptureFault.COLLECTION_CLOSED, "collection %s was freed" % _collection))
	var left := [parts.size()]
	var read_one := func(place: int) -> void:
		results[place] = await _read(parts[place], depth)
		left[0] -= 1
	for place in parts.size():
		read_one.call(place)
	while left[0] > 0 and is_instance_valid(_fetch):
		await Fetcher.next_frame()
	return results


## The rows of a shard by their keys, the parts of a node, or a CaptureFault.
func _read(part: CollectionIndex.Part, depth: int) -> Variant:
	var data: Variant = await _load.call(part)
	if data is CaptureFault:
		return data
	return CollectionIndex.rows(data, part) if depth == 0 else CollectionIndex.parts_of(data, part, _collection, depth - 1)
