extends RefCounted
## Files on the device, each named by the SHA-256 of what it holds, so that a name never means other bytes.
##
## Every load hashes the file anew and fetches it again where it is damaged. When the limit is passed, those that were not
## used for the longest time go first.

const Fetcher := preload("fetcher.gd")

const PART := ".part"
## Most bytes of a file whose size nobody has told.
const UNTOLD_BYTES := 64 << 20
## Seconds from one use of a file to the next one that is noted: notes cost writes to the device's memory.
const USE_EVERY_S := 3600

## Bytes that all files together may take.
var limit: int
var _folder: String
var _under_way := {}  # by hash: the Load that others wait for


func _init(folder: String, most: int) -> void:
	_folder = folder
	limit = most
	DirAccess.make_dir_recursive_absolute(folder)
	# An app that was killed while it downloaded leaves these behind.
	for file in DirAccess.get_files_at(folder):
		if file.ends_with(PART):
			DirAccess.remove_absolute(folder.path_join(file))


## Whether a file is here, by its name and its size: its bytes are looked at when it is loaded. size: -1 for any.
func has(sha256: String, size: int) -> bool:
	var file := FileAccess.open(_path(sha256), FileAccess.READ)
	return file != null and (size < 0 or file.get_length() == size)


## Take a file off the device. False where it is not here.
func remove(sha256: String) -> bool:
	return DirAccess.remove_absolute(_path(sha256)) == OK


## Bytes of all files.
func bytes() -> int:
	var sum := 0
	for file in _files():
		sum += file.size
	return sum


## The bytes of the file with this hash, from the device or else from the address, or a CaptureFault. Loads of one file at
## the same time download it once. fetch: a node of the fetcher's script, in the tree. size: -1 where it is not known.
## told: called with the bytes that have come, or invalid.
func read(fetch: Node, url: String, sha256: String, size: int, told := Callable()) -> Variant:
	if not is_hash(sha256):
		return CaptureFault.new(CaptureFault.CATALOGUE_TRUNCATED, "%s is no SHA-256" % sha256)
	while _under_way.has(sha256):
		var other: Load = _under_way[sha256]
		while not other.ended and is_instance_valid(other.fetch):
			await Fetcher.next_frame()
		if other.ended:
			return other.result
		if _under_way.get(sha256) == other:
			_under_way.erase(sha256)  # its collection was freed, and nothing of it goes on
	var mine := Load.new()
	mine.fetch = fetch
	_under_way[sha256] = mine
	mine.result = await _read(fetch, url, sha256, size, told)
	mine.ended = true
	_under_way.erase(sha256)
	return mine.result


## Put bytes in the place of a file: a crash or a full disk leaves the old file or the new one. Whether there was room for it.
static func replace(path: String, content: PackedByteArray) -> bool:
	var part := path + PART
	var file := FileAccess.open(part, FileAccess.WRITE)
	if file == null:
		return false
	file.store_buffer(content)
	file.close()
	# On a full disk the file is shorter, which nothing above is sure to tell.
	var is_whole := FileAccess.get_file_as_bytes(part) == content
	if is_whole and DirAccess.rename_absolute(part, path) == OK:
		return true
	DirAccess.remove_absolute(part)
	return false


static func is_hash(text: String) -> bool:
	return text.length() == 64 and text.is_valid_hex_number() and text == text.to_lower()


func _read(fetch: Node, url: String, sha256: String, size: int, told: Callable) -> Variant:
	var path := _path(sha256)
	if FileAccess.file_exists(path):
		if await _hash(fetch, path) == sha256:
			_note_use(path)
			return _content(path)
		DirAccess.remove_absolute(path)
	DirAccess.make_dir_recursive_absolute(_folder)  # systems clear the files of apps while these run
	var part := "%s.%d%s" % [path, Time.get_ticks_usec(), PART]
	var fault: CaptureFault = await fetch.to_file(url, part, UNTOLD_BYTES if size < 0 else size, told)
	if fault == null:
		fault = await _accepted(fetch, part, url, sha256)
	if fault != null:
		DirAccess.remove_absolute(part)
		return fault
	_evict(sha256)
	return _content(path)


## A name appears only with all its bytes on the disk.
func _accepted(fetch: Node, part: String, url: String, sha256: String) -> CaptureFault:
	if await _hash(fetch, part) != sha256:
		var what := "%s: its bytes do not have the hash of the catalogue" % url
		return CaptureFault.new(
			CaptureFault.FILE_CHANGED, what, "It was damaged on the way or tampered with, and is not shown"
		)
	return null if DirAccess.rename_absolute(part, _path(sha256)) == OK else _unkept(url)


func _hash(fetch: Node, path: String) -> String:
	return await fetch.in_background(func() -> String: return FileAccess.get_sha256(path))


func _content(path: String) -> Variant:
	var content := FileAccess.get_file_as_bytes(path)
	return content if FileAccess.get_open_error() == OK else _unkept(path)


func _unkept(what: String) -> CaptureFault:
	return CaptureFault.new(
		CaptureFault.STORAGE_FAILED, "%s cannot be kept on this device" % what, "Free some storage"
	)


func _path(sha256: String) -> String:
	return _folder.path_join(sha256)


## Godot can set no file's time, but a file that is written to gets a new one, also where the byte is the one that it had.
func _note_use(path: String) -> void:
	if Time.get_unix_time_from_system() - FileAccess.get_modified_time(path) < USE_EVERY_S:
		return
	var file := FileAccess.open(path, FileAccess.READ_WRITE)
	if file == null or file.get_length() == 0:
		return
	file.seek(0)
	var first := file.get_8()
	file.seek(0)
	file.store_8(first)


func _evict(kept: String) -> void:
	var files := _files()
	var sum := bytes()
	files.sort_custom(func(one: Stored, other: Stored) -> bool: return one.used < other.used)
	for file in files:
		if sum <= limit:
			return
		if file.name != kept and remove(file.name):
			sum -= file.size


func _files() -> Array[Stored]:
	var found: Array[Stored] = []
	for name in DirAccess.get_files_at(_folder):
		if is_hash(name):
			found.append(Stored.new(name, _path(name)))
	return found


## A file on the device, and when it was used last: to the hour.
class Stored:
	var name: String
	var size: int
	var used: int

	func _init(file: String, path: String) -> void:
		name = file
		size = FileAccess.get_size(path)
		used = FileAccess.get_modified_time(path)


## A file on its way, and the node that fetches it.
class Load:
	var fetch: Node
	var ended := false
	var result: Variant
