# What all tests have: a new device before each, the server, and expectations.
extends Node

const PATIENCE_MS := 60_000

var facts := {}
var reasons := PackedStringArray()


func prepare() -> void:
	if DirAccess.dir_exists_absolute("user://capture2vr"):
		_delete("user://capture2vr")
	CaptureCollection._cache = null
	await turn_to("v2")


## Have the server's way "live" serve this folder.
func turn_to(folder: String) -> void:
	await ask("turn/" + folder)


func ask(path: String) -> String:
	var request := HTTPRequest.new()
	add_child(request)
	request.request("%s/%s" % [facts["server"], path])
	var answer: Array = await request.request_completed
	request.queue_free()
	return answer[3].get_string_from_utf8()


func count(path: String) -> int:
	return int(await ask("count/" + path))


func collection(way := "live", key := true, named := "default") -> CaptureCollection:
	var made := CaptureCollection.new()
	made.base_url = "%s/%s" % [facts["server"], way]
	made.collection = named
	if key:
		made.public_keys = [facts["key"]]
	add_child(made)
	return made


func opened(way := "live", key := true) -> CaptureCollection:
	var made := collection(way, key)
	expect_ok(await made.open())
	return made


func expect(holds: bool, what: String) -> void:
	if not holds:
		reasons.append("not so: " + what)


func expect_equal(wanted: Variant, found: Variant) -> void:
	if typeof(wanted) != typeof(found) or wanted != found:
		reasons.append("wanted %s, found %s" % [wanted, found])


func expect_ok(found: Variant) -> void:
	if found is CaptureFault:
		reasons.append(str(found))


func expect_fault(code: String, found: Variant) -> void:
	expect(found is CaptureFault and found.code == code, "%s, but %s" % [code, found])


## Waits for something that must come.
func comes(holds: Callable) -> void:
	var start := Time.get_ticks_msec()
	while not holds.call():
		if Time.get_ticks_msec() - start > PATIENCE_MS:
			reasons.append("it does not come")
			return
		await get_tree().process_frame


static func _delete(folder: String) -> void:
	for file in DirAccess.get_files_at(folder):
		DirAccess.remove_absolute(folder.path_join(file))
	for below in DirAccess.get_directories_at(folder):
		_delete(folder.path_join(below))
	DirAccess.remove_absolute(folder)
