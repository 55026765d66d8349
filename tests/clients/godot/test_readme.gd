# The examples of the README, each in a function of its own.
extends "res://tests/suite.gd"


func test_the_examples_of_the_readme_compile() -> void:
	var files := DirAccess.get_files_at("res://readme")
	expect(not files.is_empty(), "there are examples")
	for file in files:
		if file.ends_with(".gd"):
			expect((load("res://readme/" + file) as GDScript).can_instantiate(), file)
