extends RefCounted
## The highest version that this device has seen of each thing, in a file of lines "version name". Whoever serves an older
## one, a stale cache or an attacker, is refused.

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


## Replaced as a whole: a crash leaves the old file or the new one.
func _write() -> void:
	var lines := PackedStringArray()
	for name: String in _highest:
		lines.append("%d %s" % [_highest[name], name])
	var part := _path + ".part"
	var file := FileAccess.open(part, FileAccess.WRITE)
	if file == null:
		return
	file.store_string("\n".join(lines))
	file.close()
	DirAccess.rename_absolute(part, _path)
