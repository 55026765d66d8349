class_name CaptureRow
extends RefCounted
## An asset as its collection lists it.

var key: String
## Its name for people.
var label: String
var version: int
var removed: bool
## Words to find it by.
var labels := PackedStringArray()
var manifest_sha256: String
## The hash of its picture, or "".
var preview_sha256: String


## The row of these cells, or null where they are none.
static func of(columns: Array, words: Array, cells: Variant) -> CaptureRow:
	var row := new()
	return row if row._take(cells_by_name(columns, cells), words) else null


## Cells by the names of their columns; empty where there are not as many.
static func cells_by_name(columns: Array, cells: Variant) -> Dictionary:
	var told := {}
	if cells is Array and cells.size() == columns.size():
		for place in columns.size():
			told[columns[place]] = cells[place]
	return told


func manifest_name() -> String:
	return "assets/%s/manifest.%s.json" % [key, manifest_sha256]


func preview_name() -> String:
	return "assets/%s/preview.%s.png" % [key, preview_sha256]


func _take(told: Dictionary, words: Array) -> bool:
	for name: String in ["key", "label", "manifest", "preview"]:
		if not told.get(name) is String:
			return false
	if not (told.get("version") is float and told.get("labels") is Array):
		return false
	key = told["key"]
	label = told["label"]
	version = int(told["version"])
	removed = _word(words, told.get("state")) == "removed"
	for place: Variant in told["labels"]:
		labels.append(_word(words, place))
	manifest_sha256 = hexadecimal(told["manifest"])
	preview_sha256 = hexadecimal(told["preview"])
	return manifest_sha256.length() == 64 and preview_sha256.length() in [0, 64]


static func _word(words: Array, place: Variant) -> String:
	return str(words[int(place)]) if place is float and place >= 0 and place < words.size() else ""


## From base64url without padding, as rows have hashes, to hexadecimal, as names have them.
static func hexadecimal(text: String) -> String:
	if text.is_empty():
		return ""
	var padded := text.replace("-", "+").replace("_", "/") + "=".repeat(posmod(-text.length(), 4))
	return Marshalls.base64_to_raw(padded).hex_encode()
