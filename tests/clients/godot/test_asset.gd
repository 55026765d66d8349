# Assets in a scene: levels, versions, faults, nothing left behind.
extends "res://tests/suite.gd"

var _codes := PackedStringArray()


func asset(found: CaptureCollection, key := "bowl") -> CapturedAsset:
	var made := CapturedAsset.new()
	made.collection = found
	made.follow_seconds = 0.0
	made.failed.connect(func(fault: CaptureFault) -> void: _codes.append(fault.code))
	made.key = key
	return made


func shown(found: CaptureCollection, key := "bowl") -> CapturedAsset:
	var made := asset(found, key)
	add_child(made)
	await comes(func() -> bool: return made.version() > 0 or not _codes.is_empty())
	return made


func test_the_coarsest_level_is_there_first_and_finer_ones_follow() -> void:
	var made := asset(await opened())
	var first := []
	made.shown.connect(func() -> void: first.append(made.levels()))
	add_child(made)
	await comes(func() -> bool: return made.levels() == PackedInt32Array([0, 1, 2]))
	expect_equal([PackedInt32Array([2])], first)
	expect(absf(made.box().size.x - 1.2) < 2e-3, "1.2 m wide, not %s" % made.box())
	expect_equal([true, false, false], [0, 1, 2].map(func(level: int) -> bool: return made._shown[level].visible))
	expect_equal(PackedStringArray(), _codes)


func test_a_far_viewer_sees_the_coarsest_level() -> void:
	var viewer := Camera3D.new()
	viewer.position = Vector3(0, 1.6, 0)
	add_child(viewer)
	viewer.make_current()
	var made := await shown(await opened())
	expect(made.position.distance_to(Vector3(0, 0.9, -1.5)) < 1e-2, "it stands ahead, at %s" % made.position)
	await comes(func() -> bool: return made.levels() == PackedInt32Array([0, 1, 2]))
	viewer.position.z = 40.0
	await get_tree().process_frame
	await get_tree().process_frame
	expect_equal([false, false, true], [0, 1, 2].map(func(level: int) -> bool: return made._shown[level].visible))
	await comes(func() -> bool: return made.levels() == PackedInt32Array([2]))
	viewer.position.z = 0.0
	await comes(func() -> bool: return made.levels() == PackedInt32Array([0, 1, 2]))


func test_a_newer_version_comes_where_the_old_one_was() -> void:
	await turn_to("v1")
	var made := await shown(await opened())
	expect_equal(1, made.version())
	made.position = Vector3(3, 0, 3)
	await turn_to("v2")
	await made.follow()
	expect_equal([2, Vector3(3, 0, 3)], [made.version(), made.position])
	expect(absf(made.box().size.x - 1.2) < 2e-3, "1.2 m wide, not %s" % made.box())


func test_it_looks_for_newer_versions_by_itself() -> void:
	await turn_to("v1")
	var made := asset(await opened())
	made.follow_seconds = 0.1
	add_child(made)
	await comes(func() -> bool: return made.version() == 1)
	await turn_to("v2")
	await comes(func() -> bool: return made.version() == 2)


func test_what_is_removed_goes_and_comes_back() -> void:
	var made := await shown(await opened())
	await turn_to("removed")
	await made.follow()
	expect_equal([0, PackedStringArray([CaptureFault.ASSET_REMOVED])], [made.version(), _codes])
	expect(made.box().size == Vector3.ZERO, "nothing is left")


func test_an_asset_that_the_collection_does_not_have() -> void:
	await shown(await opened(), "spoon")
	expect_equal(PackedStringArray([CaptureFault.ASSET_UNKNOWN]), _codes)


func test_without_a_collection_it_says_so() -> void:
	await shown(null)
	expect_equal(PackedStringArray([CaptureFault.COLLECTION_CLOSED]), _codes)


func test_what_cannot_be_had_now_comes_later() -> void:
	await turn_to("off")
	var made := asset(collection())
	made.follow_seconds = 0.1
	add_child(made)
	await comes(func() -> bool: return CaptureFault.UNREACHABLE in _codes)
	await turn_to("v2")
	await comes(func() -> bool: return made.version() == 2)


func test_a_level_that_is_missing_leaves_its_range_to_the_next() -> void:
	await turn_to("partly")
	var made := await shown(await opened())
	await comes(func() -> bool: return CaptureFault.FILE_MISSING in _codes)
	expect_equal(PackedInt32Array([1, 2]), made.levels())
	expect(made._shown[1].visible, "the finest that there is")


func test_a_damaged_level_is_asked_for_less_and_less_often() -> void:
	await turn_to("flawed")
	var made := await shown(await opened())
	await comes(func() -> bool: return made.levels() == PackedInt32Array([1, 2]))
	await comes(func() -> bool: return _codes.size() == 4)
	expect_equal([CaptureFault.FILE_CHANGED], Array(_codes).slice(3))
	expect(made._pause > 3.0, "after four failures it waits for %s s" % made._pause)


func test_what_was_released_meanwhile_does_not_come() -> void:
	var found := await opened()
	var made := asset(found)
	add_child(made)
	made.release()
	await found.download("bowl")
	for frame in 10:
		await get_tree().process_frame
	expect_equal([0, PackedInt32Array()], [made.version(), made.levels()])


func test_it_can_be_touched() -> void:
	var made := asset(await opened())
	made.box_collider = true
	add_child(made)
	await comes(func() -> bool: return made.version() > 0)
	await get_tree().physics_frame
	await get_tree().physics_frame
	var above := made.to_global(Vector3(0, 5, 0))
	var ray := PhysicsRayQueryParameters3D.create(above, made.to_global(Vector3(0, -5, 0)))
	var hit := made.get_world_3d().direct_space_state.intersect_ray(ray)
	expect(not hit.is_empty() and absf(made.to_local(hit["position"]).y - 0.6) < 2e-3, "a ray hits its top: %s" % hit)


func test_nothing_is_left_of_what_is_freed_while_it_loads() -> void:
	var found := await opened()
	expect_ok(await found.download("bowl"))
	var before := Performance.get_monitor(Performance.OBJECT_ORPHAN_NODE_COUNT)
	for frames in 40:
		var made := asset(found)
		add_child(made)
		for frame in frames:
			await get_tree().process_frame
		made.free()
	for frame in 60:
		await get_tree().process_frame
	await comes(func() -> bool: return Performance.get_monitor(Performance.OBJECT_ORPHAN_NODE_COUNT) == before)


func test_what_is_outside_the_tree_when_it_comes_is_shown_all_the_same() -> void:
	var made := asset(await opened())
	var told := []
	made.shown.connect(func() -> void: told.append(made.levels()))
	add_child(made)
	remove_child(made)
	await comes(func() -> bool: return not told.is_empty())
	add_child(made)
	await comes(func() -> bool: return made.levels() == PackedInt32Array([0, 1, 2]))
	made.queue_free()


func test_an_asset_whose_collection_is_freed_says_so_and_takes_another() -> void:
	var found := collection("drip/v2")
	var made := asset(found)
	made.follow_seconds = 0.1
	add_child(made)
	for frame in 5:
		await get_tree().process_frame
	found.free()
	await comes(func() -> bool: return CaptureFault.COLLECTION_CLOSED in _codes)
	made.collection = await opened()
	await comes(func() -> bool: return made.version() == 2)


func test_nothing_is_left_behind() -> void:
	var found := await opened()
	await get_tree().process_frame
	var before := Performance.get_monitor(Performance.OBJECT_NODE_COUNT)
	var made := await shown(found)
	await comes(func() -> bool: return made.levels().size() == 3)
	made.queue_free()
	await comes(func() -> bool: return Performance.get_monitor(Performance.OBJECT_NODE_COUNT) == before)
