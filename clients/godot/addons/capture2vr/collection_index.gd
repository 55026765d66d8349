extends RefCounted
## Reads the catalogue of a collection: its signed root, the nodes and shards below it, and the manifests of its assets.
##
## A root lists nodes, which list further ones, down to the shards with the rows; an index lists all shards itself.
## Whatever is wrong with the bytes becomes a CaptureFault CATALOGUE_TRUNCATED with the name of the object.

const Ed25519 := preload("ed25519.gd")
const FileCache := preload("file_cache.gd")

const NUMBER := TYPE_FLOAT  # what JSON's numbers are, whole ones too
const ID_DIGITS := 16  # of the SHA-256 of a public key
const MOST_DEPTH := 8
const MOST_BYTES := 16 << 20  # of a node or a shard

var version: int
## How many nodes are between the root and a shard.
var depth: int
var parts: Array[Part] = []


## What is asked for first.
static func root_name(collection: String) -> String:
	return "collections/%s/root.json" % collection


## What there is where a root is not: in stores that were written before there were roots.
static func index_name(collection: String) -> String:
	return "collections/%s/index.json" % collection


## The root or the index in its object, once its signature holds for one of the keys, or a CaptureFault. name: for people.
## keys: of 32 bytes each; with none no signature is asked for.
static func read(data: PackedByteArray, name: String, collection: String, keys: Array[PackedByteArray]) -> Variant:
	var envelope: Variant = _document(data)
	if not _has(envelope, {"signed": TYPE_STRING, "signatures": TYPE_ARRAY}):
		return _truncated(name)
	if not keys.is_empty():
		var fault := _check(name, envelope["signed"], envelope["signatures"], keys)
		if fault != null:
			return fault
	return _index(name, JSON.parse_string(envelope["signed"]), collection)


## What a node lists, or a CaptureFault. below: the depth of that.
static func parts_of(data: PackedByteArray, node: Part, collection: String, below: int) -> Variant:
	var found: Array[Part] = []
	return found if _add_children(found, _document(data), collection, below) else _truncated(node.object_name)


## The assets of a shard by their key, or a CaptureFault.
static func rows(data: PackedByteArray, shard: Part) -> Variant:
	var document: Variant = _document(data)
	if not _has(document, {"columns": TYPE_ARRAY, "words": TYPE_ARRAY, "rows": TYPE_ARRAY}):
		return _truncated(shard.object_name)
	var found := {}
	for cells: Variant in document["rows"]:
		var row: CaptureRow = CaptureRow.of(document["columns"], document["words"], cells)
		if row == null:
			return _truncated(shard.object_name)
		found[row.key] = row
	return found


## The levels of detail of a version, the finest first, or a CaptureFault.
static func levels(data: PackedByteArray, name: String) -> Variant:
	var document: Variant = _document(data)
	if not _has(document, {"lods": TYPE_ARRAY}):
		return _truncated(name)
	var found: Array[Level] = []
	for told: Variant in document["lods"]:
		var level := Level.of(told)
		if level == null:
			return _truncated(name)
		found.append(level)
	found.sort_custom(func(one: Level, other: Level) -> bool: return one.number < other.number)
	return found if not found.is_empty() else _truncated(name)


static func _document(data: PackedByteArray) -> Variant:
	var json := JSON.new()
	return json.data if json.parse(data.get_string_from_utf8()) == OK else null


static func _index(name: String, document: Variant, collection: String) -> Variant:
	if not _has(document, {"collection": TYPE_STRING, "version": NUMBER}):
		return _truncated(name)
	if document["collection"] != collection:
		var what := "%s is the catalogue of collection %s" % [name, document["collection"]]
		return CaptureFault.new(CaptureFault.CATALOGUE_OTHER, what)
	var index := new()
	index.version = int(document["version"])
	return index if index._take(document, collection) else _truncated(name)


## Whether the text lists parts, as a tree or all shards at once.
func _take(document: Dictionary, collection: String) -> bool:
	if _has(document, {"children": TYPE_ARRAY, "depth": NUMBER}):
		depth = int(document["depth"])
		return depth >= 0 and depth <= MOST_DEPTH and _add_children(parts, document, collection, depth)
	return _has(document, {"shards": TYPE_ARRAY}) and document["shards"].all(
		func(told: Variant) -> bool: return told is Dictionary and _add(parts, told, collection, 0)
	)


## Whether these are parts, each a list of cells by the names of the columns.
static func _add_children(found: Array[Part], document: Variant, collection: String, below: int) -> bool:
	if not _has(document, {"columns": TYPE_ARRAY, "children": TYPE_ARRAY}):
		return false
	for cells: Variant in document["children"]:
		var told := CaptureRow.cells_by_name(document["columns"], cells)
		if not told.get("sha256") is String:
			return false
		told["sha256"] = CaptureRow.hexadecimal(told["sha256"])
		if not _add(found, told, collection, below):
			return false
	return true


static func _add(found: Array[Part], told: Dictionary, collection: String, below: int) -> bool:
	var types := {"sha256": TYPE_STRING, "bytes": NUMBER, "count": NUMBER, "first": TYPE_STRING, "last": TYPE_STRING}
	if not _has(told, types) or not FileCache.is_hash(told["sha256"]):
		return false
	if told["bytes"] < 0 or told["bytes"] > MOST_BYTES:
		return false
	found.append(Part.new(collection, "shard" if below == 0 else "node", told))
	return true


## That one of the keys has signed the text. One suffices: while keys are exchanged there are two.
static func _check(name: String, text: String, told: Array, keys: Array[PackedByteArray]) -> CaptureFault:
	if told.is_empty():
		return CaptureFault.new(CaptureFault.SIGNATURE_MISSING, "%s: nobody has signed it" % name)
	var known := {}
	for key in keys:
		known[_sha256(key).left(ID_DIGITS)] = key
	var others := PackedStringArray()
	for each: Variant in told:
		if not _has(each, {"key": TYPE_STRING, "ed25519": TYPE_STRING}):
			return _truncated(name)
		if not known.has(each["key"]):
			others.append(each["key"])
		elif Ed25519.verify(known[each["key"]], text.to_utf8_buffer(), Marshalls.base64_to_raw(each["ed25519"])):
			return null
	if others.size() == told.size():
		var what := "%s is signed by %s, which this app does not believe" % [name, ", ".join(others)]
		return CaptureFault.new(CaptureFault.KEY_UNKNOWN, what)
	return CaptureFault.new(
		CaptureFault.SIGNATURE_WRONG,
		"%s: the signature is not that of this text" % name,
		"The catalogue was damaged or tampered with, and nothing of it is shown"
	)


static func _sha256(data: PackedByteArray) -> String:
	var context := HashingContext.new()
	context.start(HashingContext.HASH_SHA256)
	context.update(data)
	return context.finish().hex_encode()


static func _has(document: Variant, types: Dictionary) -> bool:
	if not document is Dictionary:
		return false
	return types.keys().all(func(name: String) -> bool: return typeof(document.get(name)) == types[name])


static func _truncated(name: String) -> CaptureFault:
	return CaptureFault.new(CaptureFault.CATALOGUE_TRUNCATED, "%s is no whole catalogue" % name)


## A shard or a node as a list has it. Its name follows from collection and hash, whatever the list may say.
class Part:
	var object_name: String
	var sha256: String
	var bytes: int
	## Rows below it, and the keys of the first and the last of them.
	var count: int
	var first: String
	var last: String

	func _init(collection: String, kind: String, told: Dictionary) -> void:
		object_name = "collections/%s/%s.%s.json" % [collection, kind, told["sha256"]]
		sha256 = told["sha256"]
		bytes = int(told["bytes"])
		count = int(told["count"])
		first = told["first"]
		last = told["last"]


## A file of a manifest: one level of detail, 0 being the finest.
class Level:
	var number: int
	var object_name: String
	var sha256: String
	var bytes: int

	static func of(told: Variant) -> Level:
		var types := {"level": NUMBER, "name": TYPE_STRING, "sha256": TYPE_STRING, "bytes": NUMBER}
		if not told is Dictionary:
			return null
		for name: String in types:
			if typeof(told.get(name)) != types[name]:
				return null
		# It becomes the name of a file, which may be removed.
		if not FileCache.is_hash(told["sha256"]):
			return null
		var level := Level.new()
		level.number = int(told["level"])
		level.object_name = told["name"]
		level.sha256 = told["sha256"]
		level.bytes = int(told["bytes"])
		return level
