# Collections: what is trusted, what is kept, what goes wrong.
extends "res://tests/suite.gd"

const CollectionIndex := preload("res://addons/capture2vr/collection_index.gd")
const Fetcher := preload("res://addons/capture2vr/fetcher.gd")
const Ed25519 := preload("res://addons/capture2vr/ed25519.gd")


func test_signatures_hold_or_do_not() -> void:
	for each: Dictionary in facts["signatures"]:
		var parts: Array = [each["key"], each["message"], each["signature"]].map(Marshalls.base64_to_raw)
		expect_equal(each["holds"], Ed25519.verify(parts[0], parts[1], parts[2]))


func test_a_collection_tells_its_assets() -> void:
	var found := await opened()
	expect_equal(PackedStringArray(["bowl", "cup"]), await found.keys())
	expect_equal(PackedStringArray(["bowl", "cup"]), await found.keys("kitchen"))
	expect_equal(PackedStringArray(), await found.keys("garden"))
	var bowl: CaptureRow = (await found.rows())[0]
	expect_equal(["Bowl", 2, PackedStringArray(["kitchen", "round"])], [bowl.label, bowl.version, bowl.labels])


func test_levels_come_finest_first_and_are_those_of_the_manifest() -> void:
	var found := await opened()
	var levels: Variant = await found.levels("bowl")
	expect_ok(levels)
	expect_equal(facts["lods"].map(func(lod: Dictionary) -> String: return lod["sha256"]), levels.map(func(level: Variant) -> String: return level.sha256))


func test_what_was_downloaded_is_there_without_a_network() -> void:
	var found := await opened()
	var shares := []
	var whole: int = await found.remaining_bytes("bowl")
	expect(whole > 0, "something is to come")
	expect_ok(await found.download("bowl", shares.append))
	expect(shares.back() == 1.0 and shares.min() > 0.0, "progress ends at 1: %s" % [shares])
	expect_equal(0, await found.remaining_bytes("bowl"))
	await turn_to("off")
	var later := await opened()
	expect_ok(await later.download("bowl"))
	expect_fault(CaptureFault.UNREACHABLE, await later.download("cup"))
	expect_equal(whole, await later.clear("bowl"))
	expect_equal(whole, await later.remaining_bytes("bowl"))


func test_a_collection_that_is_freed_while_it_loads_holds_up_no_other() -> void:
	var found := await opened()
	var level: Variant = (await found.levels("bowl"))[0]
	found.base_url = "%s/drip/v2" % facts["server"]
	found.level_bytes(level)
	for frame in 5:
		await get_tree().process_frame
	var waiting := await opened()
	var got := []
	(func() -> void: got.append(await waiting.level_bytes(level))).call()
	found.queue_free()
	var later := await opened()
	(func() -> void: got.append(await later.level_bytes(level))).call()
	await comes(func() -> bool: return got.size() == 2)
	for each: Variant in got:
		expect_ok(each)


func test_a_collection_outside_the_tree_says_so() -> void:
	var found := CaptureCollection.new()
	found.base_url = "%s/live" % facts["server"]
	expect_fault(CaptureFault.COLLECTION_CLOSED, await found.open())
	found.free()


func test_what_leaves_the_tree_while_it_loads_is_loaded_all_the_same() -> void:
	var found := collection()
	var got := []
	(func() -> void: got.append(await found.open())).call()
	remove_child(found)
	await comes(func() -> bool: return got.size() == 1)
	expect(got == [null] or got[0] is CaptureFault, "it ends, with %s" % [got])
	add_child(found)
	expect_ok(await found.open())


func test_a_manifest_names_no_files_of_the_app() -> void:
	var told := {"lods": [{"level": 0, "name": "assets/bowl/lod0.glb", "sha256": "../../save.dat", "bytes": 3}]}
	expect_fault(CaptureFault.CATALOGUE_TRUNCATED, CollectionIndex.levels(JSON.stringify(told).to_utf8_buffer(), "manifest"))


func test_files_are_loaded_once() -> void:
	var found := await opened("www/once")
	await found.download("bowl")
	await found.download("bowl")
	var level: Variant = (await found.levels("bowl"))[0]
	expect_equal(1, await count("www/once/" + level.object_name))


func test_a_full_disk_leaves_the_last_good_catalogue() -> void:
	await turn_to("v1")
	expect_ok(await (await opened()).row_of("bowl"))
	var folder := ProjectSettings.globalize_path("user://capture2vr")
	var below: String = Array(DirAccess.get_directories_at(folder)).filter(func(each: String) -> bool: return each != "files")[0]
	# A file of the system that can be opened and takes nothing.
	for part: String in ["index.json.part", "versions.txt.part"]:
		expect_equal(0, OS.execute("ln", ["-s", "/proc/self/oom_score_adj", folder.path_join(below).path_join(part)]))
	await turn_to("v2")
	await opened()
	await turn_to("off")
	var later := await opened()
	expect_equal(1, (await later.row_of("bowl")).version if later.is_open() else 0)


func test_without_a_network_a_first_start_fails() -> void:
	await turn_to("off")
	expect_fault(CaptureFault.UNREACHABLE, await collection().open())


func test_a_server_that_is_not_there_is_unreachable() -> void:
	var found := collection()
	found.base_url = "http://127.0.0.1:9"
	expect_fault(CaptureFault.UNREACHABLE, await found.open())


func test_a_collection_that_is_not_there() -> void:
	expect_fault(CaptureFault.FILE_MISSING, await collection("live", true, "other").open())


func test_a_signature_of_somebody_else_is_refused() -> void:
	var found := collection()
	found.public_keys = [Marshalls.raw_to_base64("01234567890123456789012345678901".to_utf8_buffer())]
	expect_fault(CaptureFault.KEY_UNKNOWN, await found.open())
	expect_fault(CaptureFault.COLLECTION_CLOSED, await found.row_of("bowl"))


func test_one_key_of_several_suffices() -> void:
	var found := collection()
	found.public_keys.append(Marshalls.raw_to_base64("01234567890123456789012345678901".to_utf8_buffer()))
	expect_ok(await found.open())


func test_an_index_that_was_changed_is_refused() -> void:
	await turn_to("altered")
	expect_fault(CaptureFault.SIGNATURE_WRONG, await collection().open())
	expect_ok(await collection("live", false).open())


func test_an_index_that_nobody_signed_is_refused() -> void:
	await turn_to("unsigned")
	expect_fault(CaptureFault.SIGNATURE_MISSING, await collection().open())


func test_an_index_of_another_collection_is_refused() -> void:
	await turn_to("swapped")
	expect_fault(CaptureFault.CATALOGUE_OTHER, await collection("live", true, "other").open())


func test_an_index_that_is_none_is_refused() -> void:
	for each: String in facts["broken"]:
		await turn_to(each)
		expect_fault(CaptureFault.CATALOGUE_TRUNCATED, await collection("live", false).open())


func test_an_older_index_is_refused_after_a_restart_too() -> void:
	await opened()
	await turn_to("v1")
	expect_fault(CaptureFault.CATALOGUE_OLDER, await collection().open())


func test_an_asset_that_was_removed() -> void:
	await turn_to("removed")
	var found := await opened()
	expect_equal(PackedStringArray(["cup"]), await found.keys())
	expect_fault(CaptureFault.ASSET_REMOVED, await found.row_of("bowl"))
	expect_fault(CaptureFault.ASSET_UNKNOWN, await found.download("spoon"))


func test_private_assets_need_the_headers() -> void:
	expect_fault(CaptureFault.ACCESS_REFUSED, await collection("keyed").open())
	var found := collection("keyed")
	found.headers = ["Authorization: Bearer good"]
	expect_ok(await found.open())
	expect_ok(await found.download("bowl"))


func test_private_assets_may_lie_where_the_server_redirects_to() -> void:
	for shown: PackedStringArray in [PackedStringArray(["Authorization: Bearer good"]), PackedStringArray()]:
		var found := collection("away")
		found.headers = shown
		expect_ok(await found.open())
		expect_ok(await found.download("bowl"))
		await prepare()


func test_files_that_are_not_what_was_signed_are_not_kept() -> void:
	for way: String in ["flip", "endless", "cut", "busy"]:
		var found := await opened()
		found.base_url = "%s/%s/v2" % [facts["server"], way]
		var fault: Variant = await found.level_bytes((await _levels_known_to(found))[0])
		var wanted := CaptureFault.UNREACHABLE if way in ["cut", "busy"] else CaptureFault.FILE_CHANGED
		expect_fault(wanted, fault)
		expect_equal([], Array(DirAccess.get_files_at("user://capture2vr/files")).filter(_is_partial))
		await prepare()


func test_a_server_that_falls_silent_is_left_and_holds_up_nothing() -> void:
	Fetcher.silence_s = 0.5
	var found := collection("stall/v2")
	var longest := [0, Time.get_ticks_msec()]
	var watch := func() -> void:
		longest[0] = maxi(longest[0], Time.get_ticks_msec() - longest[1])
		longest[1] = Time.get_ticks_msec()
	get_tree().process_frame.connect(watch)
	expect_fault(CaptureFault.UNREACHABLE, await found.open())
	found.free()
	await get_tree().process_frame
	get_tree().process_frame.disconnect(watch)
	expect(longest[0] < 5000, "a frame took %d ms" % longest[0])
	Fetcher.silence_s = 15.0


func test_a_damaged_file_on_the_device_is_healed() -> void:
	var found := await opened()
	await found.download("bowl")
	var level: Variant = (await found.levels("bowl"))[0]
	var path: String = "user://capture2vr/files/" + level.sha256
	var file := FileAccess.open(path, FileAccess.READ_WRITE)
	file.store_8(1)
	file.close()
	expect_ok(await found.level_bytes(level))
	expect_equal(level.sha256, FileAccess.get_sha256(path))


func test_the_limit_of_the_device_is_kept() -> void:
	var found := collection()
	found.cache_bytes = 1
	expect_ok(await found.open())
	expect_ok(await found.download("bowl"))
	expect_equal(1, DirAccess.get_files_at("user://capture2vr/files").size())


func test_what_was_not_used_for_long_goes_first() -> void:
	var folder := "user://capture2vr/files"
	var found := await opened()
	await found.download("bowl")
	var paths := Array(DirAccess.get_files_at(folder)).map(func(file: String) -> String: return ProjectSettings.globalize_path(folder.path_join(file)))
	expect_equal(0, OS.execute("touch", ["-d", "2 days ago"] + paths))
	var level: Variant = (await found.levels("bowl"))[1]
	expect_ok(await found.level_bytes(level))
	var used := Array(DirAccess.get_files_at(folder)).filter(func(file: String) -> bool:
		return Time.get_unix_time_from_system() - FileAccess.get_modified_time(folder.path_join(file)) < 3600)
	expect(level.sha256 in used and used.size() < paths.size(), "%s are used, of %d" % [used, paths.size()])
	expect_equal(level.sha256, FileAccess.get_sha256(folder.path_join(level.sha256)))
	var cache: Variant = CaptureCollection._cache
	cache.limit = used.reduce(func(sum: int, file: String) -> int: return sum + FileAccess.get_size(folder.path_join(file)), 0)
	cache._evict("")
	expect_equal(used, Array(DirAccess.get_files_at(folder)))


func test_a_preview_is_a_picture_or_a_fault() -> void:
	var found := await opened()
	expect_fault(CaptureFault.MESH_INVALID, await found.preview((await found.rows())[0]))
	expect_equal(null, await found.preview((await found.rows())[1]))


func _levels_known_to(found: CaptureCollection) -> Array:
	var base := found.base_url
	found.base_url = "%s/live" % facts["server"]
	var levels: Variant = await found.levels("bowl")
	found.base_url = base
	return levels


static func _is_partial(file: String) -> bool:
	return file.ends_with(".part")
