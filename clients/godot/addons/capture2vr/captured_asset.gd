class_name CapturedAsset
extends Node3D
## Shows an asset by its key as a child of this node: at once in its coarsest level of detail, then in finer ones as the viewer
## comes near. Takes newer versions, and frees what is not seen.

const CollectionIndex := preload("collection_index.gd")
const GltfExtension := preload("gltf_extension.gd")
const LevelOfDetail := preload("level_of_detail.gd")

const LONGEST_PAUSE_S := 600.0  # the pause doubles with every failure: a damaged version would else be asked for again and again
const LEVEL_PAUSE_S := 0.25  # between two looks at the distance
const FAR_S := 5.0  # a level that was not wanted for so long is freed
const RELUCTANCE := 1.25  # nor is one that a step forward would bring back

## A version stands there, in its coarsest level.
signal shown
## It cannot be shown, or not as finely as it should.
signal failed(fault: CaptureFault)

## The collection that it is of.
@export var collection: CaptureCollection
## Key of the asset in its collection.
@export var key := ""
## Stand it on the floor ahead of the camera once it is there.
@export var place_ahead := true
## Give it a box to be touched and grabbed by.
@export var box_collider := false
## Seconds between looks for a newer version; 0 for none.
@export var follow_seconds := 10.0

var _version := 0
var _files: Array[CollectionIndex.Level] = []
var _missing := {}  # numbers of levels that the server does not have
var _shown := {}  # levels that are there, by their number
var _box := AABB()
var _body: StaticBody3D
var _turn := 0  # of showing and releasing: what comes late must see that it is not wanted any more
var _wanted := false
var _placed := false
var _looking := false
var _asked: CaptureCollection
var _refining := false
var _pause := 0.0
var _next_look := 0.0
var _next_levels := 0.0
var _far_since := 0.0


func _ready() -> void:
	if not key.is_empty():
		show_asset()


func _process(_delta: float) -> void:
	var now := _now()
	var may_look := not _looking or not is_instance_valid(_asked)  # a collection that was freed does not answer
	if _wanted and follow_seconds > 0.0 and may_look and now >= _next_look:
		follow()
	if not _shown.is_empty():
		_choose_level()
		if not _refining and now >= _next_levels:
			refine()


## Load the asset and show it, instead of what was shown; ends when its coarsest level is there. What cannot be had now is
## tried again when newer versions are looked for.
func show_asset() -> void:
	release()
	_wanted = true
	_pause = follow_seconds
	await _look(false)


## Take the newer version if there is one. The old one stands until the new one is there, and stays if that cannot be had or
## is refused. An asset that was removed goes, and comes again when it is restored.
func follow() -> void:
	await _look(true)


## Load the next finer level where the viewer is near enough, and free those that were too fine for a while. Without a camera
## all levels are wanted.
func refine() -> void:
	var turn := _turn
	_refining = true
	var fault := await _refine()
	_refining = false
	if turn != _turn:
		return
	if fault != null:
		_tell(fault)
	_next_levels = _now() + maxf(LEVEL_PAUSE_S, _pause if _pause > follow_seconds else 0.0)


## Free the asset. The files stay on the device.
func release() -> void:
	_wanted = false
	_turn += 1
	_free_levels()


## The version that is shown; 0 while none is.
func version() -> int:
	return _version


## The box of the asset at true size, in metres, in the frame of this node; empty while none is shown.
func box() -> AABB:
	return _box


## Numbers of the levels of detail that are there, 0 the finest.
func levels() -> PackedInt32Array:
	var numbers := PackedInt32Array(_shown.keys())
	numbers.sort()
	return numbers


## Stand it on the floor ahead of a viewer, its front towards the viewer; at a comfortable height where it is small.
func place_ahead_of(viewer: Node3D, floor_height := 0.0) -> void:
	if not _shown.is_empty():
		var size := _box.size * global_basis.get_scale()
		global_transform = LevelOfDetail.place_ahead(viewer.global_transform, size, floor_height, global_basis.get_scale())


func _look(for_newer: bool) -> void:
	var turn := _turn
	_looking = true
	_asked = collection if is_instance_valid(collection) else null
	var fault := await _take(turn, for_newer)
	if turn == _turn and fault != null:
		if fault.code in [CaptureFault.ASSET_UNKNOWN, CaptureFault.ASSET_REMOVED]:
			_free_levels()  # taken out of the collection, so out of sight
		_tell(fault)
	_looking = false
	_next_look = _now() + _pause


func _take(turn: int, for_newer: bool) -> CaptureFault:
	if not is_instance_valid(collection):
		return CaptureFault.new(CaptureFault.COLLECTION_CLOSED, "no collection is set for %s" % key)
	if for_newer or not collection.is_open():
		var fault := await collection.open()
		if fault != null:
			return fault
	var row: Variant = await collection.row_of(key)
	if row is CaptureFault:
		return row
	if row.version == _version:
		_pause = follow_seconds
		return null
	return await _load(turn, row)


## Show the coarsest of the levels that can be had.
func _load(turn: int, row: CaptureRow) -> CaptureFault:
	var files: Variant = await collection.levels_of(row)
	if files is CaptureFault:
		return files
	var missing := {}
	var last: CaptureFault
	for place in range(files.size() - 1, -1, -1):
		var level: Variant = await _made(files[place])
		if turn != _turn:
			_discard(level)
			return null
		if level is Node3D:
			_show(row.version, files, missing, files[place].number, level)
			return null
		last = level
		if not last.code in [CaptureFault.FILE_MISSING, CaptureFault.FILE_CHANGED]:
			return last
		missing[files[place].number] = true
	return CaptureFault.new(CaptureFault.FILE_MISSING, "%s: none of its files can be had; the last: %s" % [key, last.message])


func _show(
	new_version: int, files: Array[CollectionIndex.Level], missing: Dictionary, number: int, level: Node3D
) -> void:
	_free_levels()
	_version = new_version
	_files = files
	_missing = missing
	_pause = follow_seconds
	_next_levels = _now()
	_far_since = _now()
	_add(number, level)
	var viewer := _viewer()
	if place_ahead and not _placed and viewer != null:
		place_ahead_of(viewer)
	_placed = true  # a newer version comes where the old one was, wherever it has been carried
	shown.emit()


func _refine() -> CaptureFault:
	var present := levels()
	var wanted := PackedInt32Array()
	for file in _files:
		if not _missing.has(file.number):
			wanted.append(file.number)
	if present.is_empty() or wanted.is_empty():
		return null
	var share := _share_of_view()
	_free_finer(LevelOfDetail.level(wanted, share * RELUCTANCE))
	if present[0] <= LevelOfDetail.level(wanted, share):
		return null
	# One step at a time: each is there four times sooner than the next.
	for place in range(_files.size() - 1, -1, -1):
		var file := _files[place]
		if file.number < present[0] and not _missing.has(file.number):
			return await _add_level(file)
	return null


func _add_level(file: CollectionIndex.Level) -> CaptureFault:
	var turn := _turn
	var of_version := _version
	var level: Variant = await _made(file)
	if turn != _turn or of_version != _version:
		_discard(level)
		return null
	if level is Node3D:
		_add(file.number, level)
		_pause = follow_seconds
		return null
	if level.code in [CaptureFault.FILE_MISSING, CaptureFault.MESH_INVALID]:
		_missing[file.number] = true
	return level


func _made(file: CollectionIndex.Level) -> Variant:
	var data: Variant = await collection.level_bytes(file)
	if data is CaptureFault:
		return data
	GltfExtension.register()  # here, since other threads may read files meanwhile
	var held: LevelOfDetail.Held = await collection.in_background(LevelOfDetail.held.bind(data, file.object_name))
	return held.taken()


func _add(number: int, level: Node3D) -> void:
	add_child(level)
	_shown[number] = level
	_box = LevelOfDetail.box_of(_shown[levels()[0]])
	_choose_level()
	if box_collider:
		_enclose()


func _free_finer(wanted: int) -> void:
	var too_fine := Array(levels()).filter(func(number: int) -> bool: return number < wanted)
	if too_fine.is_empty():
		_far_since = _now()
	if _now() - _far_since < FAR_S:
		return
	for number: int in too_fine:
		_shown[number].queue_free()
		_shown.erase(number)


## Only one level is seen at a time.
func _choose_level() -> void:
	var seen := LevelOfDetail.level(levels(), _share_of_view())
	for number: int in _shown:
		_shown[number].visible = number == seen


## The share of the view's height that it takes; more than all without a camera.
func _share_of_view() -> float:
	var viewer := _viewer()
	if viewer == null or viewer.projection != Camera3D.PROJECTION_PERSPECTIVE:
		return INF
	var away := maxf(1e-3, viewer.global_position.distance_to(global_transform * _box.get_center()))
	var height := _box.get_longest_axis_size() * global_basis.get_scale().x
	return height / (2.0 * away * tan(deg_to_rad(viewer.fov) / 2.0))


func _viewer() -> Camera3D:
	return get_viewport().get_camera_3d() if is_inside_tree() else null


func _enclose() -> void:
	if _body == null:
		_body = StaticBody3D.new()
		var shape := CollisionShape3D.new()
		shape.shape = BoxShape3D.new()
		_body.add_child(shape)
		add_child(_body)
	var collider: CollisionShape3D = _body.get_child(0)
	collider.position = _box.get_center()
	(collider.shape as BoxShape3D).size = _box.size


func _free_levels() -> void:
	for level: Node3D in _shown.values():
		level.queue_free()
	if _body != null:
		_body.queue_free()
		_body = null
	_shown.clear()
	_files = []
	_missing = {}
	_version = 0
	_box = AABB()


static func _discard(level: Variant) -> void:
	if level is Node3D:
		level.free()


func _tell(fault: CaptureFault) -> void:
	_pause = minf(LONGEST_PAUSE_S, 2.0 * maxf(LEVEL_PAUSE_S, _pause))  # 0 where nobody looks for newer versions
	if failed.get_connections().is_empty():
		push_error("%s cannot be shown: %s" % [key, fault])
	failed.emit(fault)


static func _now() -> float:
	return Time.get_ticks_msec() / 1000.0
