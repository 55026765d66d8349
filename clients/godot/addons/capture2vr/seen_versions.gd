extends RefCounted
## The highest version that this device has seen of each thing, in a file of lines "version name". Whoever serves an older
## one, a stale cache or an attacker, is refused.

const FileCache := preload("file_cache.gd")

var _path: String
var _highest := {}


func _init(path: String) -> void:
	_path = path
	# Lines that make no sense are left out: better to forget one version than to show nothing at all.
	for line in FileAccess.get_file_as_string(path).split("\n", false):
		var parts := line.split(" ", true, 1)
		if parts.size() == 2 and parts[0].is_valid_int():
			_highest[parts[1]] = int(parts[0])


## CATALOGUE_OLDER for an older version than the highest, else null; keeps a higher one.
func check(name: String, version: int) -> CaptureFault:
	var highest: int = _highest.get(name, -1)
	if version < highest:
		var what := "%s: version %d was offered, but this device has seen version %d" % [name, version, highest]
		return CaptureFault.new(
			CaptureFault.CATALOGUE_OLDER, what, "The server or a cache on the way is out of date; try again later"
		)
	if version > highest:
		_highest[name] = version
		_write()
	return null


## A full disk is no fault: this run remembers, and the next version that is seen writes all of them.
func _write() -> void:
	var lines := PackedStringArray()
	for name: String in _highest:
		lines.append("%d %s" % [_highest[name], name])
	FileCache.replace(_path, "\n".join(lines).to_utf8_buffer())
