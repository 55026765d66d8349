# Catalogues as trees: what is read of them, what goes wrong with their parts.
extends "res://tests/suite.gd"


func test_a_tree_has_all_assets_in_order() -> void:
	for depth in 3:
		var found := await _opened("tree%d" % depth)
		expect_equal(PackedStringArray(facts["trees"]["tree%d" % depth]["keys"]), await found.keys())
		expect_equal(PackedStringArray(["bowl", "cup"]), await found.keys("kitchen"))
		expect_ok(await found.download("cup"))
		for absent: String in ["a", "bowl0", "z"]:
			expect_fault(CaptureFault.ASSET_UNKNOWN, await found.row_of(absent))
		await prepare()


func test_one_asset_costs_the_root_and_one_file_of_each_level() -> void:
	for depth in 3:
		var told: Dictionary = facts["trees"]["tree%d" % depth]
		var way := "www/tree%d" % depth
		var found := _collection(way)
		expect_ok(await found.open())
		expect_ok(await found.row_of("cup"))
		expect_ok(await found.row_of("cup"))
		expect_equal(depth + 1, told["path"].size())
		for file: String in told["files"]:
			var wanted := 1 if file in told["path"] or file.ends_with("root.json") else 0
			expect_equal(wanted, await count("%s/%s" % [way, file]))


func test_a_page_of_a_list_reads_no_further() -> void:
	var keys: Array = facts["trees"]["tree2"]["keys"]
	var found := await _opened("tree2")
	expect_equal(keys.slice(0, 5), _keys_of(await found.rows("", 5)))
	expect(DirAccess.get_files_at("user://capture2vr/files").size() <= 2 + 2, "two nodes and two shards are here")
	expect_equal(keys.slice(5, 18), _keys_of(await found.rows(keys[4], 13)))
	expect_equal(keys.slice(-2), _keys_of(await found.rows(keys[-3], 48)))
	expect_equal([], _keys_of(await found.rows("z", 48)))
	expect_equal([], _keys_of(await found.rows("", 0)))


func test_where_a_part_has_gone_it_begins_again_at_the_newer_root() -> void:
	for level in 3:
		var found := await _opened("tree_without_%d" % level)
		expect_fault(CaptureFault.FILE_MISSING, await found.row_of("cup"))
		expect_fault(CaptureFault.FILE_MISSING, await found.rows())
		await turn_to("tree_newer")
		expect_ok(await found.row_of("cup"))
		await prepare()
	var behind := await _opened("tree2")
	await turn_to("tree_newer")
	expect_ok(await behind.rows())


func test_a_part_that_was_changed_is_refused() -> void:
	for spoilt: String in ["changed", "longer"]:
		for level in 3:
			var found := await _opened("tree_%s_%d" % [spoilt, level])
			expect_fault(CaptureFault.FILE_CHANGED, await found.row_of("cup"))
			expect_fault(CaptureFault.FILE_CHANGED, await found.rows())
			await prepare()


func test_an_older_root_is_refused() -> void:
	await _opened("tree_newer")
	await turn_to("tree2")
	expect_fault(CaptureFault.CATALOGUE_OLDER, await _collection("live").open())
	await turn_to("flat")
	expect_fault(CaptureFault.CATALOGUE_OLDER, await _collection("live").open())


func test_a_root_that_is_none_is_refused() -> void:
	for spoilt: String in ["tree_too_deep", "tree_too_large", "tree_outside", "stub"]:
		await turn_to(spoilt)
		expect_fault(CaptureFault.CATALOGUE_TRUNCATED, await _collection("live").open())


func test_a_store_without_a_root_is_read_by_its_index() -> void:
	var found := await _opened("flat")
	expect_equal(PackedStringArray(["bowl", "cup"]), await found.keys())
	expect_ok(await found.download("cup"))


func test_what_was_looked_at_in_a_tree_is_there_without_a_network() -> void:
	var found := await _opened("tree2")
	expect_ok(await found.download("cup"))
	await turn_to("off")
	var later := _collection("live")
	expect_ok(await later.open())
	expect_ok(await later.download("cup"))
	expect_fault(CaptureFault.UNREACHABLE, await later.row_of("c000"))


func _collection(way: String) -> CaptureCollection:
	var made := collection(way)
	made.public_keys = [facts["trees"]["key"]]
	return made


func _opened(folder: String) -> CaptureCollection:
	await turn_to(folder)
	var made := _collection("live")
	expect_ok(await made.open())
	return made


static func _keys_of(listed: Variant) -> Array:
	return [listed] if listed is CaptureFault else listed.map(func(row: CaptureRow) -> String: return row.key)
