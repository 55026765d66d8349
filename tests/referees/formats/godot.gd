# What Godot has imported into the project, as lines "READ path triangles textured".
extends SceneTree

func _init():
	for path in OS.get_cmdline_args():
		if path.begins_with("res://"):
			print("READ ", path, " ", count(load(path)))
	quit()

func count(found):
	if found is Mesh:
		return triangles_of(found)
	return in_node(found.instance()) if found is PackedScene else "none none"

func triangles_of(mesh):
	var triangles = 0
	var textured = "none"
	for surface in range(mesh.get_surface_count()):
		triangles += mesh.surface_get_array_index_len(surface) / 3
		if mesh.surface_get_arrays(surface)[Mesh.ARRAY_COLOR] != null:
			textured = "vertices"
		var material = mesh.surface_get_material(surface)
		if material is SpatialMaterial and material.get_texture(SpatialMaterial.TEXTURE_ALBEDO):
			textured = "texture"
	return str(triangles) + " " + textured

func in_node(node):
	if node is MeshInstance:
		return triangles_of(node.mesh)
	for child in node.get_children():
		var found = in_node(child)
		if found != "none none":
			return found
	return "none none"
