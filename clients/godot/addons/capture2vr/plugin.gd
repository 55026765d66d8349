@tool
extends EditorPlugin
## Has the editor import the files of captured assets, too.

const GltfExtension := preload("gltf_extension.gd")


func _enter_tree() -> void:
	GltfExtension.register()


func _exit_tree() -> void:
	GltfExtension.unregister()
