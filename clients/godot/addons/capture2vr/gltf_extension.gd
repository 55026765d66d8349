extends GLTFDocumentExtension
## Reads files that are compressed with EXT_meshopt_compression, and numbers of KHR_mesh_quantization, which Godot's own
## importer does not.
##
## Colours at the vertices of captured assets are linear light in 16 bits. Godot keeps 8 bits of a colour, which would band
## in the shadows: they are turned to sRGB first, and the material says so.

const MeshoptDecoder := preload("meshopt_decoder.gd")

const COMPRESSION := "EXT_meshopt_compression"
const QUANTIZATION := "KHR_mesh_quantization"
const GENERATOR := "capture2vr"
const MOST_GROWTH := 64  # rows that are all alike: two bits for each sixteen bytes
const WORD := 4  # bytes to which views are aligned
const UNSIGNED_SHORT := 5123  # component type
const COLOURS_KEY := &"capture2vr_srgb"

static var _registered: GLTFDocumentExtension


## Have all glTF files read with this extension from now on, once.
static func register() -> void:
	if _registered == null:
		_registered = new()
		GLTFDocument.register_gltf_document_extension(_registered)


## Have Godot's own importer alone again.
static func unregister() -> void:
	if _registered != null:
		GLTFDocument.unregister_gltf_document_extension(_registered)
		_registered = null


func _get_supported_extensions() -> PackedStringArray:
	return [COMPRESSION, QUANTIZATION]


func _import_preflight(state: GLTFState, extensions: PackedStringArray) -> Error:
	var document: Dictionary = state.json
	state.set_additional_data(COLOURS_KEY, false)
	if COMPRESSION in extensions:
		var error := _decompress(state, document)
		if error != OK:
			return error
	if String(document.get("asset", {}).get("generator", "")).begins_with(GENERATOR):
		_turn_colours(state, document)
	return OK


func _import_post(state: GLTFState, _root: Node) -> Error:
	if state.get_additional_data(COLOURS_KEY):
		for material in state.materials:
			if material is BaseMaterial3D:
				material.vertex_color_is_srgb = true
	return OK


## All views into one buffer, the compressed ones decoded.
func _decompress(state: GLTFState, document: Dictionary) -> Error:
	var data := PackedByteArray()
	for view: Dictionary in document.get("bufferViews", []):
		var content := _content(state.glb_data, view)
		if content.size() != int(view.get("byteLength", 0)):
			return ERR_FILE_CORRUPT
		view["buffer"] = 0
		view["byteOffset"] = data.size()
		view.get("extensions", {}).erase(COMPRESSION)
		data.append_array(content)
		data.resize(ceili(data.size() / float(WORD)) * WORD)
	document["buffers"] = [{"byteLength": data.size()}]
	state.glb_data = data
	state.json = document
	return OK


func _content(binary: PackedByteArray, view: Dictionary) -> PackedByteArray:
	var packed: Dictionary = view.get("extensions", {}).get(COMPRESSION, {})
	var place := view if packed.is_empty() else packed
	var start := int(place.get("byteOffset", 0))
	var part := binary.slice(start, start + int(place.get("byteLength", 0)))
	if packed.is_empty():
		return part
	var count := int(packed.get("count", 0))
	var stride := int(packed.get("byteStride", 0))
	# Checked before anything is made so long: no stream grows more, and what is announced costs nothing.
	if count * stride != int(view.get("byteLength", 0)) or count * stride > MOST_GROWTH * part.size():
		return PackedByteArray()
	return MeshoptDecoder.decoded(part, count, stride, packed.get("mode", ""), packed.get("filter", "NONE"))


func _turn_colours(state: GLTFState, document: Dictionary) -> void:
	var data := state.glb_data
	for mesh: Dictionary in document.get("meshes", []):
		for primitive: Dictionary in mesh.get("primitives", []):
			var number := int(primitive.get("attributes", {}).get("COLOR_0", -1))
			if number < 0:
				continue
			var accessor: Dictionary = document["accessors"][number]
			if int(accessor.get("componentType", 0)) == UNSIGNED_SHORT:
				_turn_to_srgb(data, document["bufferViews"][int(accessor["bufferView"])], accessor)
				state.set_additional_data(COLOURS_KEY, true)
	state.glb_data = data


func _turn_to_srgb(data: PackedByteArray, view: Dictionary, accessor: Dictionary) -> void:
	var width := 3 if accessor["type"] == "VEC3" else 4
	var stride := int(view.get("byteStride", 2 * width))
	var place := int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
	for row in int(accessor["count"]):
		for part in 3:
			var at := place + 2 * part
			data.encode_u16(at, roundi(_srgb(data.decode_u16(at) / 65535.0) * 65535.0))
		place += stride


## IEC 61966-2-1.
func _srgb(light: float) -> float:
	return 12.92 * light if light <= 0.0031308 else 1.055 * pow(light, 1.0 / 2.4) - 0.055
