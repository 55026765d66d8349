extends RefCounted
## Decodes buffer views that meshoptimizer has compressed, as EXT_meshopt_compression describes them.
##
## All three modes and all three filters. A stream that is cut off, or that goes on behind its end, gives an empty array.

const ATTRIBUTES_HEADER := 0xa0
const TRIANGLES_HEADER := 0xe1
const INDICES_HEADER := 0xd1

const GROUP := 16  # elements that share one number of bits
const GROUP_BYTES := 24  # at most, of a group
const TAIL_BYTES := 32  # at least, behind the blocks: the first row of all is at its end
const INDICES_TAIL_BYTES := 4  # behind the indices
const CODES_BYTES := 16  # behind the triangles: the codes of the most frequent corners


## The bytes of a view: count rows of stride bytes.
static func decoded(
	source: PackedByteArray, count: int, stride: int, mode: String, filter := "NONE"
) -> PackedByteArray:
	var rows := PackedByteArray()
	match mode:
		"ATTRIBUTES":
			rows = _attributes(source, count, stride)
		"TRIANGLES":
			rows = _bytes_of(_triangles(source, count), stride)
		"INDICES":
			rows = _bytes_of(_indices(source, count), stride)
	if rows.is_empty():
		return rows
	match filter:
		"OCTAHEDRAL":
			_filter_octahedral(rows, stride)
		"QUATERNION":
			_filter_quaternion(rows)
		"EXPONENTIAL":
			_filter_exponential(rows)
	return rows


## Blocks of rows; in a block byte after byte of all rows, each as its difference from the row before.
static func _attributes(source: PackedByteArray, count: int, stride: int) -> PackedByteArray:
	if source.size() < 1 + maxi(TAIL_BYTES, stride) or source[0] != ATTRIBUTES_HEADER or stride < 1:
		return PackedByteArray()
	var rows := PackedByteArray()
	rows.resize(count * stride)
	var before := source.slice(source.size() - stride)
	var most := mini((8192 / stride) & ~(GROUP - 1), 256)
	var at := 1
	for start in range(0, count, most):
		var block := mini(most, count - start)
		for byte in stride:
			at = _byte_of_block(source, at, rows, start * stride + byte, block, stride, before[byte])
			if at < 0:
				return PackedByteArray()
		before = rows.slice((start + block - 1) * stride, (start + block) * stride)
	return rows if at == source.size() - maxi(TAIL_BYTES, stride) else PackedByteArray()


## One byte of each row of a block, into every stride-th place; where the next byte's begin, or -1 at the end of the stream.
static func _byte_of_block(
	source: PackedByteArray, start: int, rows: PackedByteArray, place: int, block: int, stride: int, value: int
) -> int:
	var groups := (block + GROUP - 1) / GROUP
	var at := start + (groups + 3) / 4
	for group in groups:
		if at + GROUP_BYTES > source.size():
			return -1
		var bits := (source[start + group / 4] >> (2 * (group % 4))) & 3
		var elements := mini(GROUP, block - GROUP * group)
		if bits == 0:
			for element in elements:
				rows[place] = value
				place += stride
			continue
		var packed := 2 << (bits - 1)  # bits of an element: 2, 4 or 8
		var escape := (1 << packed) - 1 if packed < 8 else 256
		var whole := at + 2 * packed  # elements that do not fit into so many bits follow as whole bytes
		for element in GROUP:
			var bit := packed * element
			var delta := (source[at + (bit >> 3)] >> (8 - packed - (bit & 7))) & ((1 << packed) - 1)
			if delta == escape:
				delta = source[whole]
				whole += 1
			if element < elements:
				value = (value + ((delta >> 1) ^ -(delta & 1))) & 255
				rows[place] = value
				place += stride
		at = whole
	return at


## Corners of triangles, each told by the edges and vertices that came last.
static func _triangles(source: PackedByteArray, count: int) -> PackedInt64Array:
	var triangles := count / 3
	if count % 3 or source.size() < 1 + triangles + CODES_BYTES or source[0] != TRIANGLES_HEADER:
		return PackedInt64Array()
	var reader := TriangleReader.new(source, 1 + triangles)
	for triangle in triangles:
		if not reader.read(source[1 + triangle]):
			return PackedInt64Array()
	return reader.corners if reader.at == reader.codes else PackedInt64Array()


## Indices, each as its difference from one of the last two.
static func _indices(source: PackedByteArray, count: int) -> PackedInt64Array:
	if source.size() < 1 + count + INDICES_TAIL_BYTES or source[0] != INDICES_HEADER:
		return PackedInt64Array()
	var reader := VarintReader.new(source, 1)
	var last := [0, 0]
	var found := PackedInt64Array()
	for each in count:
		var word := reader.word()
		var current := word & 1
		last[current] += VarintReader.signed(word >> 1)
		found.append(last[current])
	return found if reader.at == source.size() - INDICES_TAIL_BYTES else PackedInt64Array()


static func _bytes_of(indices: PackedInt64Array, stride: int) -> PackedByteArray:
	var bytes := PackedByteArray()
	bytes.resize(stride * indices.size())
	for place in indices.size():
		if stride == 2:
			bytes.encode_u16(2 * place, indices[place])
		else:
			bytes.encode_u32(4 * place, indices[place])
	return bytes


## Unit vectors, of which two numbers and the length of one are stored; the fourth number stays.
static func _filter_octahedral(rows: PackedByteArray, stride: int) -> void:
	var wide := stride == 8
	var most := 32767.0 if wide else 127.0
	var size := stride / 4
	for place in range(0, rows.size(), stride):
		var one := float(_signed_at(rows, place + 2 * size, wide))
		var x := _signed_at(rows, place, wide) / one
		var y := _signed_at(rows, place + size, wide) / one
		var z := 1.0 - absf(x) - absf(y)
		var folded := maxf(-z, 0.0)
		x += -folded if x >= 0.0 else folded
		y += -folded if y >= 0.0 else folded
		var length := most / sqrt(x * x + y * y + z * z)
		_put(rows, place, wide, roundi(x * length))
		_put(rows, place + size, wide, roundi(y * length))
		_put(rows, place + 2 * size, wide, roundi(z * length))


static func _signed_at(rows: PackedByteArray, place: int, wide: bool) -> int:
	return rows.decode_s16(place) if wide else rows.decode_s8(place)


static func _put(rows: PackedByteArray, place: int, wide: bool, value: int) -> void:
	if wide:
		rows.encode_s16(place, value)
	else:
		rows.encode_s8(place, value)


## Unit quaternions, whose largest number is left out: the lowest bits of the fourth tell which.
static func _filter_quaternion(rows: PackedByteArray) -> void:
	for place in range(0, rows.size(), 8):
		var told := rows.decode_s16(place + 6)
		var scale := sqrt(0.5) / (told | 3)
		var parts := [0.0, 0.0, 0.0]
		var rest := 1.0
		for part in 3:
			parts[part] = rows.decode_s16(place + 2 * part) * scale
			rest -= parts[part] * parts[part]
		var largest := told & 3
		rows.encode_s16(place + 2 * largest, roundi(sqrt(maxf(rest, 0.0)) * 32767.0))
		for part in 3:
			rows.encode_s16(place + 2 * ((largest + 1 + part) & 3), roundi(parts[part] * 32767.0))


## Floats, as a whole number of 24 bits and an exponent of 8.
static func _filter_exponential(rows: PackedByteArray) -> void:
	for place in range(0, rows.size(), 4):
		var word := rows.decode_s32(place)
		var mantissa := ((word & 0xffffff) ^ 0x800000) - 0x800000
		rows.encode_float(place, mantissa * pow(2.0, word >> 24))


## Numbers of one to five bytes, seven bits in each, the lowest first.
class VarintReader:
	var source: PackedByteArray
	var at: int

	func _init(bytes: PackedByteArray, start: int) -> void:
		source = bytes
		at = start

	func word() -> int:
		var found := 0
		for shift in range(0, 35, 7):
			if at >= source.size():
				return 0
			var byte := source[at]
			at += 1
			found |= (byte & 127) << shift
			if byte < 128:
				break
		return found

	## Zigzag: 0, -1, 1, -2, …
	static func signed(value: int) -> int:
		return (value >> 1) ^ -(value & 1)


## The state of the codec of triangles: the last sixteen edges and vertices, the highest vertex so far.
class TriangleReader:
	extends VarintReader
	var corners := PackedInt64Array()
	var edges := PackedInt64Array()
	var vertices := PackedInt64Array()
	var edge := 0
	var vertex := 0
	var next := 0
	var last := 0
	var codes: int

	func _init(bytes: PackedByteArray, start: int) -> void:
		super(bytes, start)
		codes = bytes.size() - CODES_BYTES
		edges.resize(32)
		edges.fill(0)
		vertices.resize(16)
		vertices.fill(0)

	## One triangle; false at the end of the stream.
	func read(code: int) -> bool:
		if code < 0xf0:
			_read_beside(code >> 4, code & 15)
		elif code < 0xfe:
			_read_apart(0, source[codes + (code & 15)])
		else:
			var corner_codes := source[at]
			at += 1
			if corner_codes == 0:
				next = 0
			_read_apart(0 if code == 0xfe else 15, corner_codes)
		return at <= codes

	## A triangle that shares an edge with one of the last.
	func _read_beside(back: int, code: int) -> void:
		var place := 2 * ((edge - 1 - back) & 15)
		var a := edges[place]
		var b := edges[place + 1]
		var c: int
		if code == 13 or code == 14:
			last += -1 if code == 13 else 1
			c = last
			_remember(c)
		else:
			c = _corner(code, -1)
			if code == 0 or code == 15:
				_remember(c)
		corners.append_array(PackedInt64Array([a, b, c]))
		_remember_edge(c, b)
		_remember_edge(a, c)

	## A triangle that shares none; the first corner's code is 0 or 15.
	func _read_apart(first: int, code: int) -> void:
		var second := code >> 4
		var third := code & 15
		# New vertices are counted before any is read from the stream.
		var a := _counted(first)
		var b := _counted(second)
		var c := _counted(third)
		if first == 15:
			a = _from_stream()
		if second == 15:
			b = _from_stream()
		if third == 15:
			c = _from_stream()
		corners.append_array(PackedInt64Array([a, b, c]))
		_remember(a)
		if second == 0 or second == 15:
			_remember(b)
		if third == 0 or third == 15:
			_remember(c)
		_remember_edge(b, a)
		_remember_edge(c, b)
		_remember_edge(a, c)

	func _corner(code: int, offset: int) -> int:
		if code == 0:
			return _counted(0)
		return _from_stream() if code == 15 else vertices[(vertex + offset - code) & 15]

	func _counted(code: int) -> int:
		if code == 0:
			next += 1
			return next - 1
		return vertices[(vertex - code) & 15]

	func _from_stream() -> int:
		last += VarintReader.signed(word())
		return last

	func _remember(index: int) -> void:
		vertices[vertex] = index
		vertex = (vertex + 1) & 15

	func _remember_edge(a: int, b: int) -> void:
		edges[2 * edge] = a
		edges[2 * edge + 1] = b
		edge = (edge + 1) & 15
