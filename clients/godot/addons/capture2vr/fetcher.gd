extends Node
## Downloads files a few at a time, and runs work beside the main thread.

const TOGETHER := 4
const REDIRECTIONS: Array[int] = [301, 302, 303, 307, 308]
const MOST_REDIRECTS := 5
## At most, of each download in a frame: 12 MB/s at 90 frames a second.
const CHUNK_BYTES := 128 << 10
## A server that sends nothing for so long has gone. The whole of a download may take any time.
static var silence_s := 15.0

## Sent with every request, as "Name: value".
var headers := PackedStringArray()

var _free := TOGETHER
signal _freed


## The bytes of an object, at most so many, or a CaptureFault.
func to_bytes(url: String, most: int) -> Variant:
	var answer := await _ask(url, "", most, Callable())
	var fault := _fault(url, answer, most)
	return answer.body if fault == null else fault


## Write an object into a file; null, or why not. told: called with the bytes that have come, or invalid.
func to_file(url: String, path: String, most: int, told := Callable()) -> CaptureFault:
	return _fault(url, await _ask(url, path, most, told), most)


## The app's next frame, for nodes that have left the tree too.
static func next_frame() -> void:
	await (Engine.get_main_loop() as SceneTree).process_frame


## What a function returns, which runs on another thread; it is waited for, and the app goes on meanwhile.
func in_background(work: Callable) -> Variant:
	var results := []
	var task := WorkerThreadPool.add_task(func() -> void: results.append(work.call()))
	while not WorkerThreadPool.is_task_completed(task):
		await next_frame()
	WorkerThreadPool.wait_for_task_completion(task)
	return results[0]


func _ask(url: String, path: String, most: int, told: Callable) -> Answer:
	while _free == 0:
		await _freed
	_free -= 1
	var answer := await _answer(url, headers, path, most, told)
	var asked := url
	for redirect in MOST_REDIRECTS:
		if answer.target.is_empty():
			break
		asked = _resolved(asked, answer.target)
		# The headers are for this server alone, and a secure address leads to no other kind.
		if url.begins_with("https:") and not asked.begins_with("https:"):
			break
		var shown := headers if _origin(asked) == _origin(url) else PackedStringArray()
		answer = await _answer(asked, shown, path, most, told)
	_free += 1
	_freed.emit()
	return answer


func _answer(url: String, shown: PackedStringArray, path: String, most: int, told: Callable) -> Answer:
	var request := HTTPRequest.new()
	request.download_file = path
	request.body_size_limit = most
	# Not on a thread: to end one that waits for a silent server, HTTPRequest would hold the main thread until it speaks.
	request.download_chunk_size = CHUNK_BYTES
	request.max_redirects = 0  # it would show the headers to any server, and does not follow 307 and 308
	add_child(request)
	var answer := Answer.new()
	request.request_completed.connect(answer.take)
	answer.error = request.request(url, shown)
	if answer.error == OK:
		await _ended(request, answer, told)
	request.queue_free()
	return answer


static func _origin(url: String) -> String:
	return "/".join(url.split("/").slice(0, 3))


## The address that a Location header names, which may be relative to the one that was asked for.
static func _resolved(url: String, target: String) -> String:
	if target.contains("://"):
		return target
	if target.begins_with("//"):
		return url.get_slice("//", 0) + target
	return _origin(url) + target if target.begins_with("/") else "%s/%s" % [url.get_slice("?", 0).get_base_dir(), target]


func _ended(request: HTTPRequest, answer: Answer, told: Callable) -> void:
	var come := 0
	var heard := Time.get_ticks_msec()
	while not answer.ended:
		await next_frame()
		var now := request.get_downloaded_bytes()
		if now != come:
			come = now
			heard = Time.get_ticks_msec()
			if told.is_valid():
				told.call(come)
		elif Time.get_ticks_msec() - heard > 1000 * silence_s:
			request.cancel_request()
			answer.result = HTTPRequest.RESULT_TIMEOUT
			return


func _fault(url: String, answer: Answer, most: int) -> CaptureFault:
	if answer.error == ERR_UNCONFIGURED:
		var what := "%s cannot be asked for: its collection has left the scene tree" % url
		return CaptureFault.new(CaptureFault.COLLECTION_CLOSED, what, "Call add_child() with it first")
	if answer.error != OK:
		return CaptureFault.new(CaptureFault.UNREACHABLE, "%s is no address to ask" % url)
	match answer.result:
		HTTPRequest.RESULT_SUCCESS:
			return _refusal(url, answer.status)
		HTTPRequest.RESULT_BODY_SIZE_LIMIT_EXCEEDED:
			var refusal := _refusal(url, answer.status)  # the page that tells of it may be longer than the file
			if refusal != null:
				return refusal
			var what := "%s: the server sends more than the %d bytes it should" % [url, most]
			return CaptureFault.new(CaptureFault.FILE_CHANGED, what)
		HTTPRequest.RESULT_DOWNLOAD_FILE_CANT_OPEN, HTTPRequest.RESULT_DOWNLOAD_FILE_WRITE_ERROR:
			var what := "%s cannot be kept on this device" % url
			return CaptureFault.new(CaptureFault.STORAGE_FAILED, what, "Free some storage")
		HTTPRequest.RESULT_TIMEOUT:
			return _unreachable(url, "it sent nothing for %d s" % silence_s)
	return _unreachable(url, "the connection failed (result %d)" % answer.result)


func _refusal(url: String, status: int) -> CaptureFault:
	match status:
		401, 403:
			var what := "%s: it answers %d" % [url, status]
			return CaptureFault.new(CaptureFault.ACCESS_REFUSED, what, "It is private: set the headers")
		404, 410:
			var what := "%s is not there" % url
			return CaptureFault.new(CaptureFault.FILE_MISSING, what, "A newer version may have come")
	return null if status >= 200 and status < 300 else _unreachable(url, "it answers %d" % status)


func _unreachable(url: String, reason: String) -> CaptureFault:
	return CaptureFault.new(CaptureFault.UNREACHABLE, "%s: %s" % [url, reason], "Check the connection")


## What came back.
class Answer:
	var error := OK
	var ended := false
	var result := 0
	var status := 0
	var body := PackedByteArray()
	## Where a redirection leads to, or "".
	var target := ""

	func take(new_result: int, code: int, headers: PackedStringArray, content: PackedByteArray) -> void:
		if code in REDIRECTIONS:
			for header in headers:
				if header.to_lower().begins_with("location:"):
					target = header.substr("location:".length()).strip_edges()
		ended = true
		result = new_result
		status = code
		body = content
