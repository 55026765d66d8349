# Files: compressed views, and what Godot makes of levels of detail.
extends "res://tests/suite.gd"

const GltfExtension := preload("res://addons/capture2vr/gltf_extension.gd")
const LevelOfDetail := preload("res://addons/capture2vr/level_of_detail.gd")
const MeshoptDecoder := preload("res://addons/capture2vr/meshopt_decoder.gd")


func test_streams_are_decoded_as_meshoptimizer_does() -> void:
	for each: Dictionary in facts["streams"]:
		var source := Marshalls.base64_to_raw(each["source"])
		var found := MeshoptDecoder.decoded(source, each["count"], each["stride"], each["mode"], each["filter"])
		expect_rows(Marshalls.base64_to_raw(each["rows"]), found, each)


## Directions and turns may be off by one: meshoptimizer works them out in 32 bits.
func expect_rows(wanted: PackedByteArray, found: PackedByteArray, each: Dictionary) -> void:
	if each["filter"] in ["NONE", "EXPONENTIAL"] or wanted.size() != found.size():
		expect(found == wanted, each["name"])
		return
	var wide: bool = each["stride"] == 8
	for place in range(0, wanted.size(), 2 if wide else 1):
		var off := wanted.decode_s16(place) - found.decode_s16(place) if wide else wanted.decode_s8(place) - found.decode_s8(place)
		if absi(off) > 1:
			expect(false, "%s: %d off at %d" % [each["name"], off, place])
			return


func test_streams_that_are_cut_off_give_nothing() -> void:
	for each: Dictionary in facts["streams"]:
		var source := Marshalls.base64_to_raw(each["source"])
		for length: int in [0, 1, source.size() / 4]:
			var cut := source.slice(0, length)
			var found := MeshoptDecoder.decoded(cut, each["count"], each["stride"], each["mode"], each["filter"])
			expect(found.is_empty(), "%s, cut to %d" % [each["name"], length])


func test_levels_have_the_triangles_the_box_and_the_colours_of_the_product() -> void:
	GltfExtension.register()
	for each: Dictionary in facts["files"]:
		var node: Variant = LevelOfDetail.made(FileAccess.get_file_as_bytes(each["path"]), each["path"])
		expect_ok(node)
		if node is CaptureFault:
			continue
		var mesh := LevelOfDetail.meshes_of(node)[0]
		expect_equal(int(each["triangles"]), mesh.mesh.surface_get_array_index_len(0) / 3)
		var box := LevelOfDetail.box_of(node)
		for axis in 3:
			expect(absf(box.position[axis] - each["low"][axis]) < 1e-3, "%s: low %s" % [each["path"], box])
			expect(absf(box.end[axis] - each["high"][axis]) < 1e-3, "%s: high %s" % [each["path"], box])
		_expect_look(each, mesh)
		node.free()


func _expect_look(each: Dictionary, mesh: MeshInstance3D) -> void:
	var material: BaseMaterial3D = mesh.mesh.surface_get_material(0)
	expect_equal(BaseMaterial3D.CULL_DISABLED, material.cull_mode)
	expect_equal(each["textured"], material.albedo_texture != null)
	var colours: Variant = mesh.mesh.surface_get_arrays(0)[Mesh.ARRAY_COLOR]
	expect_equal(each["rgb"] != null, colours != null)
	if colours != null:
		expect(material.vertex_color_is_srgb, "the colours are said to be sRGB")
		# The mean of all, since Godot may order vertices anew.
		var sum := Vector3.ZERO
		for colour: Color in colours:
			sum += Vector3(colour.r, colour.g, colour.b)
		for part in 3:
			expect(absf(255.0 * sum[part] / colours.size() - each["rgb"][part]) < 1.0, "%s: colours %s" % [each["path"], sum / colours.size()])


func test_a_file_that_is_no_mesh_is_a_fault() -> void:
	GltfExtension.register()
	for each: Dictionary in facts["spoilt"]:
		var found: Variant = LevelOfDetail.made(Marshalls.base64_to_raw(each["file"]), each["name"])
		expect_fault(CaptureFault.MESH_INVALID, found)


func test_the_editor_has_imported_them() -> void:
	for each: Dictionary in facts["imported"]:
		var scene: PackedScene = load(each["path"])
		expect(scene != null, each["path"])
		if scene == null:
			continue
		var node: Node3D = scene.instantiate()
		expect_equal(int(each["triangles"]), LevelOfDetail.meshes_of(node)[0].mesh.surface_get_array_index_len(0) / 3)
		node.free()


func test_the_level_follows_the_share_of_the_view() -> void:
	var shares := {INF: 0, 0.5: 0, 0.3: 0, 0.29: 1, 0.1: 1, 0.09: 2, 0.0: 2}
	for share: float in shares:
		expect_equal(shares[share], LevelOfDetail.level([0, 1, 2], share))
	expect_equal(2, LevelOfDetail.level([2], INF))
	expect_equal(2, LevelOfDetail.level([0, 2], 0.29))


func test_an_asset_stands_ahead_with_its_front_to_the_viewer() -> void:
	for each: Array in [[Vector3.FORWARD, Vector3(0, 0, -1.5)], [Vector3.RIGHT, Vector3(1.5, 0, 0)]]:
		var viewer := Transform3D(Basis.looking_at(each[0]), Vector3(0, 1.6, 0))
		var place := LevelOfDetail.place_ahead(viewer, Vector3(0.5, 1.0, 0.3), 0.0, Vector3.ONE)
		expect(place.origin.is_equal_approx(each[1]), "it stands at %s" % place.origin)
		expect((place.basis * Vector3.BACK).is_equal_approx(-each[0]), "its front is %s" % (place.basis * Vector3.BACK))
	var small := LevelOfDetail.place_ahead(Transform3D(Basis(), Vector3(0, 1.6, 0)), Vector3.ONE * 0.1, 0.0, Vector3.ONE)
	expect(absf(small.origin.y + 0.05 - 1.2) < 1e-5, "its middle is at three quarters of the eyes' height")
