# What Godot has imported into the project, as a JSON text for each path: triangles, colours and the corners of the box.
extends SceneTree


func _init() -> void:
	for path in OS.get_cmdline_user_args():
		print("READ ", JSON.stringify(_reading(load(path)).merged({"path": path})))
	quit()


func _reading(found: Resource) -> Dictionary:
	if found is PackedScene:
		var node: Node = found.instantiate()
		var read := _of_node(node, Transform3D.IDENTITY)
		node.free()
		return read
	return _of_mesh(found, Transform3D.IDENTITY) if found is Mesh else {"fault": "not imported"}


func _of_node(node: Node, above: Transform3D) -> Dictionary:
	var place: Transform3D = above * node.transform if node is Node3D else above
	if node is MeshInstance3D:
		return _of_mesh(node.mesh, place)
	for child in node.get_children():
		var read := _of_node(child, place)
		if not read.has("fault"):
			return read
	return {"fault": "it has no mesh"}


func _of_mesh(mesh: Mesh, place: Transform3D) -> Dictionary:
	var triangles := 0
	var colours := "none"
	for surface in mesh.get_surface_count():
		triangles += mesh.surface_get_array_index_len(surface) / 3
		if mesh.surface_get_arrays(surface)[Mesh.ARRAY_COLOR] != null:
			colours = "vertices"
		var material := mesh.surface_get_material(surface) as BaseMaterial3D
		if material != null and material.albedo_texture != null:
			colours = "texture"
	var box := place * mesh.get_aabb()
	return {"triangles": triangles, "colours": colours, "low": _numbers(box.position), "high": _numbers(box.end)}


func _numbers(corner: Vector3) -> Array:
	return [corner.x, corner.y, corner.z]
