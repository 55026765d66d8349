extends RefCounted
## Makes the nodes of a level of detail from its file, and says which level to show and where an asset stands.

## Below these shares of the view's height the next coarser level is fine enough: 25,000 and 5,000 triangles there come to some
## ten pixels each on a headset of 2,000 lines.
const SHARES: Array[float] = [0.3, 0.1]
const NARROWING := 3.0  # from level to level beyond these

const AHEAD_M := 1.5  # arm's length and a step: the whole of a person-sized thing is in view
const EYE_SHARE := 0.75  # the middle of small things is at this share of the eyes' height
const SMALL_M := 0.8  # a thing lower than this would lie at one's feet
const CLEARANCE_M := 0.5  # between the eyes and the near side of something large


## The node of a .glb, or a CaptureFault MESH_INVALID. May run on any thread; the extension
## of glTF is to be registered before.
static func made(data: PackedByteArray, name: String) -> Variant:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var error := document.append_from_buffer(data, "", state)
	var node: Node = document.generate_scene(state) if error == OK else null
	if node is Node3D and not meshes_of(node).is_empty():
		return node
	if node != null:
		node.free()
	return CaptureFault.new(CaptureFault.MESH_INVALID, "%s: no mesh can be made of it (%s)" % [name, error_string(error)])


## The same in a hand that frees the node where nobody takes it: who asked for it may be gone by then.
static func held(data: PackedByteArray, name: String) -> Held:
	return Held.new(made(data, name))


static func meshes_of(node: Node) -> Array[MeshInstance3D]:
	var found: Array[MeshInstance3D] = []
	if node is MeshInstance3D:
		found.append(node)
	for child in node.get_children():
		found.append_array(meshes_of(child))
	return found


## The box of a level's meshes in the frame of its parent, metres.
static func box_of(root: Node3D) -> AABB:
	var whole := AABB()
	for mesh in meshes_of(root):
		var transform := mesh.transform
		var above := mesh.get_parent()
		while mesh != root and above is Node3D:
			transform = above.transform * transform
			if above == root:
				break
			above = above.get_parent()
		var box := transform * mesh.get_aabb()
		whole = box if whole.size == Vector3.ZERO else whole.merge(box)
	return whole


## The number of the level to show at a share of the view's height, of those that there are, finest first: a level that is
## missing leaves its range to the next.
static func level(numbers: PackedInt32Array, share: float) -> int:
	for place in numbers.size() - 1:
		if share >= _least_share(numbers[place]):
			return numbers[place]
	return numbers[numbers.size() - 1]


static func _least_share(number: int) -> float:
	var last := SHARES.size() - 1
	return SHARES[mini(number, last)] / pow(NARROWING, maxi(0, number - last))


## Where an asset of this size stands ahead of a viewer: its origin is on the floor under it, its front towards +Z.
static func place_ahead(viewer: Transform3D, size: Vector3, floor_height: float, scale: Vector3) -> Transform3D:
	var gaze := -viewer.basis.z
	gaze.y = 0.0
	gaze = gaze.normalized() if gaze.length() > 1e-3 else Vector3.FORWARD
	var eye := viewer.origin
	var away := maxf(AHEAD_M, CLEARANCE_M + maxf(size.x, size.z) / 2.0)
	var lifted := floor_height + maxf(0.0, (eye.y - floor_height) * EYE_SHARE - size.y / 2.0)
	var origin := eye + away * gaze
	origin.y = lifted if size.y < SMALL_M else floor_height
	return Transform3D(Basis(Vector3.UP, atan2(-gaze.x, -gaze.z)).scaled_local(scale), origin)


## A node that is freed with this, or a fault.
class Held:
	var _content: Variant

	func _init(content: Variant) -> void:
		_content = content

	## The content, which is the caller's to free from now on.
	func taken() -> Variant:
		var content: Variant = _content
		_content = null
		return content

	func _notification(what: int) -> void:
		if what == NOTIFICATION_PREDELETE and _content is Node:
			_content.free()
