extends RefCounted
## Reads the catalogue of a collection: its signed index, the shards with the rows of its assets, and their manifests.
##
## Whatever is wrong with the bytes becomes a CaptureFault CATALOGUE_TRUNCATED with the name of the object.

const Ed25519 := preload("ed25519.gd")
const FileCache := preload("file_cache.gd")

const NUMBER := TYPE_FLOAT  # what JSON's numbers are, whole ones too
const ID_DIGITS := 16  # of the SHA-256 of a public key

var version: int
var shards: Array[Shard] = []


static func object_name(collection: String) -> String:
	return "collections/%s/index.json" % collection


## The index in its object, once its signature holds for one of the keys, or a CaptureFault. keys: of 32 bytes each; with
## none no signature is asked for.
static func read(data: PackedByteArray, collection: String, keys: Array[PackedByteArray]) -> Variant:
	var name := object_name(collection)
	var envelope: Variant = _document(data)
	if not _has(envelope, {"signed": TYPE_STRING, "signatures": TYPE_ARRAY}):
		return _truncated(name)
	if not keys.is_empty():
		var fault := _check(name, envelope["signed"], envelope["signatures"], keys)
		if fault != null:
			return fault
	return _index(name, JSON.parse_string(envelope["signed"]), collection)


## The assets of a shard by their key, or a CaptureFault.
static func rows(data: PackedByteArray, shard: Shard) -> Variant:
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
	if not _has(document, {"collection": TYPE_STRING, "version": NUMBER, "shards": TYPE_ARRAY}):
		return _truncated(name)
	if document["collection"] != collection:
		var what := "%s is the catalogue of collection %s" % [name, document["collection"]]
		return CaptureFault.new(CaptureFault.CATALOGUE_OTHER, what)
	var index := new()
	index.version = int(document["version"])
	for told: Variant in document["shards"]:
		if not _has(told, {"sha256": TYPE_STRING, "bytes": NUMBER}) or not FileCache.is_hash(told["sha256"]):
			return _truncated(name)
		index.shards.append(Shard.new(collection, told["sha256"], int(told["bytes"])))
	return index


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


## A shard as the index lists it. Its name follows from collection and hash, whatever the index may say.
class Shard:
	var object_name: String
	var sha256: String
	var bytes: int

	func _init(collection: String, of_content: String, size: int) -> void:
		object_name = "collections/%s/shard.%s.json" % [collection, of_content]
		sha256 = of_content
		bytes = size


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
