class_name CaptureCollection
extends Node
## A collection of captured assets on a server: which there are, and what of them is on the device.
##
## Files are checked by their SHA-256 and kept on the device; with public keys given, nothing is taken that is not signed.
## Functions that load must be awaited, and return a [CaptureFault] where they fail.

const CollectionIndex := preload("collection_index.gd")
const CollectionRows := preload("collection_rows.gd")
const Fetcher := preload("fetcher.gd")
const FileCache := preload("file_cache.gd")
const SeenVersions := preload("seen_versions.gd")

const FOLDER := "user://capture2vr"
const INDEX_BYTES := 4 << 20
const TRIES := 3  # a shard or a node goes when enough newer ones have come; the root of this moment names others

## Where the objects are: the "base" that GET /v1/collections/NAME of the gateway tells.
@export var base_url := ""
@export var collection := "default"
## Public keys in base64, as GET /v1/keys gives them, to be built into the app. With none, no signature is asked for.
@export var public_keys := PackedStringArray()
## Bytes that the assets of all collections may take on the device.
@export var cache_bytes := 512 << 20
## Sent with every request to the server, as "Authorization: Bearer c2v_…" for private assets.
@export var headers := PackedStringArray()

static var _cache: FileCache

var _fetch: Fetcher
var _seen: SeenVersions
var _kept: String
var _index: CollectionIndex
var _working := false
signal _worked


func _enter_tree() -> void:
	if _fetch == null:
		_fetch = Fetcher.new()
		add_child(_fetch)


## Read the root of the catalogue, so that its assets can be found; one that is open gets the newest. Without a network, the
## last one that was good. Null, or the CaptureFault.
func open() -> CaptureFault:
	if _fetch == null:
		var what := "collection %s is not in the scene tree" % collection
		return CaptureFault.new(CaptureFault.COLLECTION_CLOSED, what, "Call add_child() with it first")
	while _working:
		await _worked
	_working = true
	_prepare()
	var index: Variant = await _newest_index()
	if not index is CaptureFault:
		_index = index
	_working = false
	_worked.emit()
	return index if index is CaptureFault else null


func is_open() -> bool:
	return _index != null


## Keys of all assets, sorted, in a PackedStringArray, or a CaptureFault; those that bear a label where one is given.
func keys(label := "") -> Variant:
	var listed: Variant = await rows()
	if listed is CaptureFault:
		return listed
	var found := PackedStringArray()
	for row: CaptureRow in listed:
		if label.is_empty() or label in row.labels:
			found.append(row.key)
	return found


## The assets for people to choose from, in the order of their keys: an Array of CaptureRow, or a CaptureFault. after: those
## behind this key; most: so many, -1 for all. A page of a large collection costs no more than one of a small one.
func rows(after := "", most := -1) -> Variant:
	var reader := _reader()
	return await _of_newest(
		func(index: CollectionIndex) -> Variant: return await reader.list(index, after, most)
	)


## The picture of an asset, four sides of it, the front at the top left: an Image, null where it has none, or a CaptureFault.
func preview(row: CaptureRow) -> Variant:
	if row.preview_sha256.is_empty():
		return null
	var data: Variant = await _content(row.preview_name(), row.preview_sha256, -1)
	if data is CaptureFault:
		return data
	var image := Image.new()
	if image.load_png_from_buffer(data) != OK:
		return CaptureFault.new(CaptureFault.MESH_INVALID, "%s is no picture" % row.preview_name())
	return image


## The row of an asset, or a CaptureFault: ASSET_UNKNOWN, ASSET_REMOVED, COLLECTION_CLOSED, or why it cannot be read.
func row_of(key: String) -> Variant:
	var reader := _reader()
	var row: Variant = await _of_newest(
		func(index: CollectionIndex) -> Variant: return await reader.find(index, key)
	)
	if row is CaptureFault:
		return row
	if row == null:
		return CaptureFault.new(CaptureFault.ASSET_UNKNOWN, "collection %s has no asset %s" % [collection, key])
	return CaptureFault.new(CaptureFault.ASSET_REMOVED, "asset %s was removed" % key) if row.removed else row


## The levels of detail of an asset's current version, the finest first, or a CaptureFault.
func levels(key: String) -> Variant:
	var row: Variant = await row_of(key)
	return row if row is CaptureFault else await levels_of(row)


## The levels of detail of the version that a row has, or a CaptureFault.
func levels_of(row: CaptureRow) -> Variant:
	var data: Variant = await _content(row.manifest_name(), row.manifest_sha256, -1)
	return data if data is CaptureFault else CollectionIndex.levels(data, row.manifest_name())


## The bytes of a level of detail, or a CaptureFault. told: called with the bytes that have come.
func level_bytes(level: CollectionIndex.Level, told := Callable()) -> Variant:
	return await _content(level.object_name, level.sha256, level.bytes, told)


## Bring an asset onto the device without showing it: null, or a CaptureFault; what has come stays. progress: called with the
## share that has come, from 0 to 1.
func download(key: String, progress := Callable()) -> CaptureFault:
	var found: Variant = await levels(key)
	if found is CaptureFault:
		return found
	var sum := 0
	for level: CollectionIndex.Level in found:
		sum += level.bytes
	var done := 0
	for level: CollectionIndex.Level in found:
		var told := func(come: int) -> void: progress.call((done + come) / float(sum))
		var content: Variant = await level_bytes(level, told if progress.is_valid() else Callable())
		if content is CaptureFault:
			return content
		done += level.bytes
		if progress.is_valid():
			progress.call(done / float(sum))
	return null


## Bytes of an asset that are not on the device, or a CaptureFault; 0: it can be shown without a network.
func remaining_bytes(key: String) -> Variant:
	return await _sum_of_bytes(
		key, func(level: CollectionIndex.Level) -> bool: return not _cache.has(level.sha256, level.bytes)
	)


## Remove an asset's files from the device; how many bytes that freed, or a CaptureFault. What is shown stays.
func clear(key: String) -> Variant:
	return await _sum_of_bytes(key, func(level: CollectionIndex.Level) -> bool: return _cache.remove(level.sha256))


## What a function returns, which runs on another thread.
func in_background(work: Callable) -> Variant:
	return await _fetch.in_background(work)


## Bytes of the levels of an asset of which a function is true, or a CaptureFault.
func _sum_of_bytes(key: String, is_counted: Callable) -> Variant:
	var found: Variant = await levels(key)
	if found is CaptureFault:
		return found
	var sum := 0
	for level: CollectionIndex.Level in found:
		sum += level.bytes if is_counted.call(level) else 0
	return sum


func _prepare() -> void:
	_fetch.headers = headers
	if _cache == null:
		_cache = FileCache.new(FOLDER.path_join("files"), cache_bytes)
	_cache.limit = cache_bytes
	# A folder of its own: two servers may have collections of the same name.
	var identity := ("%s %s" % [_base(), collection]).sha256_text().left(16)
	var folder := FOLDER.path_join("collection-" + identity)
	DirAccess.make_dir_recursive_absolute(folder)
	_kept = folder.path_join("index.json")
	if _seen == null:
		_seen = SeenVersions.new(folder.path_join("versions.txt"))


## What a function finds in the catalogue, or a CaptureFault; it begins again at the newest root where a part has gone.
func _of_newest(work: Callable) -> Variant:
	var found: Variant = null
	for attempt in TRIES:
		if _index == null:
			var what := "collection %s is not open" % collection
			return CaptureFault.new(CaptureFault.COLLECTION_CLOSED, what, "Call open() first")
		found = await work.call(_index)
		if not (found is CaptureFault and found.code == CaptureFault.FILE_MISSING):
			return found
		if attempt < TRIES - 1:
			var fault := await open()
			if fault != null:
				return fault
	return found


func _reader() -> CollectionRows:
	return CollectionRows.new(
		collection,
		_fetch,
		func(part: CollectionIndex.Part) -> Variant: return await _content(part.object_name, part.sha256, part.bytes)
	)


## From the network; without one the last that was good, which is checked just the same.
func _newest_index() -> Variant:
	var object_name := CollectionIndex.root_name(collection)
	var data: Variant = await _fetch.to_bytes("%s/%s" % [_base(), object_name], INDEX_BYTES)
	# A bucket that does not let others list it refuses what it does not have.
	if data is CaptureFault and data.code in [CaptureFault.FILE_MISSING, CaptureFault.ACCESS_REFUSED]:
		object_name = CollectionIndex.index_name(collection)
		data = await _fetch.to_bytes("%s/%s" % [_base(), object_name], INDEX_BYTES)
	if not data is CaptureFault:
		var index: Variant = await _accepted(data, object_name)
		if not index is CaptureFault:
			_keep(data)
		return index
	if data.code == CaptureFault.UNREACHABLE and FileAccess.file_exists(_kept):
		return await _accepted(FileAccess.get_file_as_bytes(_kept), object_name)
	return data


## Signature before version: what nobody signed must not count as seen.
func _accepted(data: PackedByteArray, object_name: String) -> Variant:
	var believed: Array[PackedByteArray] = []
	for key in public_keys:
		believed.append(Marshalls.base64_to_raw(key))
	var index: Variant = await _fetch.in_background(CollectionIndex.read.bind(data, object_name, collection, believed))
	if index is CaptureFault:
		return index
	var older := _seen.check("collection " + collection, index.version)
	return index if older == null else older


## A full disk is no fault: only a start without a network would miss it.
func _keep(data: PackedByteArray) -> void:
	FileCache.replace(_kept, data)


func _content(object_name: String, sha256: String, size: int, told := Callable()) -> Variant:
	return await _cache.read(_fetch, "%s/%s" % [_base(), object_name], sha256, size, told)


func _base() -> String:
	return base_url.trim_suffix("/")
