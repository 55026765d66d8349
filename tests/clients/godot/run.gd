# Runs the methods test_… of the scripts beside it and prints a line for each: "ok NAME" or "FAIL NAME: reason".
extends SceneTree

const FACTS := "--facts="


func _initialize() -> void:
	_run.call_deferred()


func _run() -> void:
	var facts := {}
	for argument in OS.get_cmdline_user_args():
		if argument.begins_with(FACTS):
			facts = JSON.parse_string(FileAccess.get_file_as_string(argument.trim_prefix(FACTS)))
	for file in DirAccess.get_files_at("res://tests"):
		if file.begins_with("test_") and file.ends_with(".gd"):
			await _run_script(load("res://tests/" + file), facts)
	quit()


func _run_script(script: GDScript, facts: Dictionary) -> void:
	for method in script.get_script_method_list():
		var name: String = method["name"]
		if not name.begins_with("test_"):
			continue
		var suite: Node = script.new()
		suite.facts = facts
		root.add_child(suite)
		await suite.prepare()
		await suite.call(name)
		print("ok %s" % name if suite.reasons.is_empty() else "FAIL %s: %s" % [name, "; ".join(suite.reasons)])
		suite.queue_free()
		await process_frame
