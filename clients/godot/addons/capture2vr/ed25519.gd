extends RefCounted
## Checks Ed25519 signatures (RFC 8032, 5.1.7), which Godot's Crypto does not have.
##
## Curve: -x² + y² = 1 + d·x²·y² over the numbers modulo p = 2^255 - 19; B is its base point, of prime order L. A number is
## ten limbs of 26 bits, the lowest first; limbs may leave that range between two products. It hides nothing from somebody
## who measures: verifying knows no secrets.

const Sha512 := preload("sha512.gd")

const KEY_BYTES := 32
const LIMBS := 10
const BITS := 26
const MASK := (1 << BITS) - 1
const FOLD := 608  # 2^260 modulo p

static var _d := _read("a3785913ca4deb75abd841414d0a700098e879777940c78c73fe6f2bee6c0352".hex_decode())
static var _root_of_minus_one := _read("b0a00e4a271beec478e42fad0618432fa7d7fb3d99004d2b0bdfc14f8024832b".hex_decode())
static var _base := _point("5866666666666666666666666666666666666666666666666666666666666666".hex_decode())
static var _order := _read("edd3f55c1a631258d69cf7a2def9de1400000000000000000000000000000010".hex_decode())


## Whether [S]B = R + [k]A for the key A, the signature R, S and k = SHA-512(R, A, message).
static func verify(key: PackedByteArray, message: PackedByteArray, signature: PackedByteArray) -> bool:
	if key.size() != KEY_BYTES or signature.size() != 64:
		return false
	var s := _read(signature.slice(32))
	if not _is_less(s, _order):
		return false
	var a := _point(key)
	var r := _point(signature.slice(0, 32))
	if a.is_empty() or r.is_empty():
		return false
	var k := _remainder(Sha512.of(signature.slice(0, 32) + key + message))
	var sum := _sum_of_multiples(s, _base, k, _negative(a))
	return _is_zero(_minus(_times(sum[0], r[2]), _times(r[0], sum[2]))) and _is_zero(
		_minus(_times(sum[1], r[2]), _times(r[1], sum[2]))
	)


## [s]P + [k]Q by one chain of doublings. Points are [X, Y, Z, T] with x = X/Z, y = Y/Z, T = X·Y/Z.
static func _sum_of_multiples(s: PackedInt64Array, p: Array, k: PackedInt64Array, q: Array) -> Array:
	var both := _added(p, q)
	var sum := [_number(0), _number(1), _number(1), _number(0)]
	for place in range(LIMBS * BITS - 1, -1, -1):
		sum = _doubled(sum)
		var of_p := _bit(s, place)
		var of_q := _bit(k, place)
		if of_p and of_q:
			sum = _added(sum, both)
		elif of_p:
			sum = _added(sum, p)
		elif of_q:
			sum = _added(sum, q)
	return sum


## RFC 8032, 5.1.4.
static func _added(one: Array, two: Array) -> Array:
	var a := _times(_minus(one[1], one[0]), _minus(two[1], two[0]))
	var b := _times(_plus(one[1], one[0]), _plus(two[1], two[0]))
	var c := _times(_times(_plus(one[3], one[3]), _d), two[3])
	var d := _times(_plus(one[2], one[2]), two[2])
	return _completed(_minus(b, a), _minus(d, c), _plus(d, c), _plus(b, a))


static func _doubled(one: Array) -> Array:
	var a := _times(one[0], one[0])
	var b := _times(one[1], one[1])
	var c := _times(_plus(one[2], one[2]), one[2])
	var h := _plus(a, b)
	var root := _plus(one[0], one[1])
	var e := _minus(h, _times(root, root))
	var g := _minus(a, b)
	return _completed(e, _carried(_plus(c, g)), g, h)


static func _completed(e: PackedInt64Array, f: PackedInt64Array, g: PackedInt64Array, h: PackedInt64Array) -> Array:
	return [_times(e, f), _times(g, h), _times(f, g), _times(e, h)]


static func _negative(point: Array) -> Array:
	var zero := _number(0)
	return [_minus(zero, point[0]), point[1], point[2], _minus(zero, point[3])]


## y in 255 bits and the lowest bit of x above them (RFC 8032, 5.1.3); empty for no point.
static func _point(bytes: PackedByteArray) -> Array:
	var odd := bytes[31] >> 7
	var plain := bytes.duplicate()
	plain[31] &= 127
	var y := _read(plain)
	if _bytes(y) != plain:
		return []
	var x := _root(y)
	if x.is_empty() or (odd == 1 and _is_zero(x)):
		return []
	if _bytes(x)[0] & 1 != odd:
		x = _minus(_number(0), x)
	return [x, y, _number(1), _times(x, y)]


## x with x² = (y² - 1) / (d·y² + 1) = u/v: u·v³·(u·v⁷)^((p-5)/8), times √-1 where that gives -u; empty for none.
static func _root(y: PackedInt64Array) -> PackedInt64Array:
	var square := _times(y, y)
	var u := _minus(square, _number(1))
	var v := _plus(_times(square, _d), _number(1))
	var v3 := _times(_times(v, v), v)
	var x := _times(_times(u, v3), _power(_times(_times(_times(v3, v3), v), u)))
	var found := _times(v, _times(x, x))
	if _is_zero(_minus(found, u)):
		return x
	if _is_zero(_plus(found, u)):
		return _times(x, _root_of_minus_one)
	return PackedInt64Array()


## The power of (p-5)/8 = 2^252 - 3, in binary 250 ones, 0, 1.
static func _power(z: PackedInt64Array) -> PackedInt64Array:
	var power := z
	for place in 249:
		power = _times(_times(power, power), z)
	power = _times(power, power)
	return _times(_times(power, power), z)


static func _number(value: int) -> PackedInt64Array:
	var limbs := PackedInt64Array()
	limbs.resize(LIMBS)
	limbs.fill(0)
	limbs[0] = value
	return limbs


## A number of 32 bytes, the lowest first.
static func _read(bytes: PackedByteArray) -> PackedInt64Array:
	var limbs := _number(0)
	for place in bytes.size():
		var bit := 8 * place
		var limb := bit / BITS
		var shifted := bytes[place] << (bit % BITS)
		limbs[limb] |= shifted & MASK
		if shifted > MASK:
			limbs[limb + 1] |= shifted >> BITS
	return limbs


## The 32 bytes of a number modulo p, the lowest first.
static func _bytes(number: PackedInt64Array) -> PackedByteArray:
	var limbs := _carried(_carried(number))
	# Twice, since the first time may carry once more; then p itself is taken off where it fits in.
	for turn in 2:
		var above := limbs[9] >> 21
		limbs[9] &= (1 << 21) - 1
		limbs[0] += 19 * above
		_carry(limbs)
	var whole := limbs.duplicate()
	whole[0] += 19
	_carry(whole)
	if whole[9] >> 21 == 1:
		whole[9] &= (1 << 21) - 1
		limbs = whole
	var out := PackedByteArray()
	for place in 32:
		var bit := 8 * place
		var limb := bit / BITS
		var word := limbs[limb] >> (bit % BITS)
		if bit % BITS > BITS - 8 and limb + 1 < LIMBS:
			word |= limbs[limb + 1] << (BITS - bit % BITS)
		out.append(word & 255)
	return out


static func _is_zero(number: PackedInt64Array) -> bool:
	return _bytes(number).count(0) == 32


static func _plus(a: PackedInt64Array, b: PackedInt64Array) -> PackedInt64Array:
	var sum := a.duplicate()
	for place in LIMBS:
		sum[place] += b[place]
	return sum


static func _minus(a: PackedInt64Array, b: PackedInt64Array) -> PackedInt64Array:
	var rest := a.duplicate()
	for place in LIMBS:
		rest[place] -= b[place]
	return rest


static func _times(a: PackedInt64Array, b: PackedInt64Array) -> PackedInt64Array:
	var wide := PackedInt64Array()
	wide.resize(2 * LIMBS)
	wide.fill(0)
	for i in LIMBS:
		var factor := a[i]
		for j in LIMBS:
			wide[i + j] += factor * b[j]
	_carry(wide)
	var product := wide.slice(0, LIMBS)
	for place in LIMBS:
		product[place] += FOLD * wide[LIMBS + place]
	return _carried(product)


## The same number with limbs of 26 bits, the lowest a little more.
static func _carried(number: PackedInt64Array) -> PackedInt64Array:
	var limbs := number.duplicate()
	limbs.append(0)
	_carry(limbs)
	var above := limbs[LIMBS]
	limbs.resize(LIMBS)
	limbs[0] += FOLD * above
	return limbs


## Carries all but the last limb's, in place. >> rounds down, so negative limbs borrow.
static func _carry(limbs: PackedInt64Array) -> void:
	var carry := 0
	for place in limbs.size() - 1:
		var limb := limbs[place] + carry
		limbs[place] = limb & MASK
		carry = limb >> BITS
	limbs[limbs.size() - 1] += carry


static func _bit(number: PackedInt64Array, place: int) -> int:
	return (number[place / BITS] >> (place % BITS)) & 1


static func _is_less(a: PackedInt64Array, b: PackedInt64Array) -> bool:
	for place in range(LIMBS - 1, -1, -1):
		if a[place] != b[place]:
			return a[place] < b[place]
	return false


## A number of 64 bytes, the lowest first, modulo the order: bit by bit, the highest first.
static func _remainder(bytes: PackedByteArray) -> PackedInt64Array:
	var rest := _number(0)
	for place in range(8 * bytes.size() - 1, -1, -1):
		rest = _plus(rest, rest)
		rest[0] |= (bytes[place / 8] >> (place % 8)) & 1
		_carry(rest)
		if not _is_less(rest, _order):
			rest = _minus(rest, _order)
			_carry(rest)
	return rest
