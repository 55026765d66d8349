extends RefCounted
## SHA-512 (FIPS 180-4), which Godot's HashingContext does not have.

const BLOCK_BYTES := 128

## The first 64 bits of the fractional parts of the cube roots of the first 80 primes.
const ROUND_WORDS := (
	"428a2f98d728ae227137449123ef65cdb5c0fbcfec4d3b2fe9b5dba58189dbbc"
	+ "3956c25bf348b53859f111f1b605d019923f82a4af194f9bab1c5ed5da6d8118"
	+ "d807aa98a303024212835b0145706fbe243185be4ee4b28c550c7dc3d5ffb4e2"
	+ "72be5d74f27b896f80deb1fe3b1696b19bdc06a725c71235c19bf174cf692694"
	+ "e49b69c19ef14ad2efbe4786384f25e30fc19dc68b8cd5b5240ca1cc77ac9c65"
	+ "2de92c6f592b02754a7484aa6ea6e4835cb0a9dcbd41fbd476f988da831153b5"
	+ "983e5152ee66dfaba831c66d2db43210b00327c898fb213fbf597fc7beef0ee4"
	+ "c6e00bf33da88fc2d5a79147930aa72506ca6351e003826f142929670a0e6e70"
	+ "27b70a8546d22ffc2e1b21385c26c9264d2c6dfc5ac42aed53380d139d95b3df"
	+ "650a73548baf63de766a0abb3c77b2a881c2c92e47edaee692722c851482353b"
	+ "a2bfe8a14cf10364a81a664bbc423001c24b8b70d0f89791c76c51a30654be30"
	+ "d192e819d6ef5218d69906245565a910f40e35855771202a106aa07032bbd1b8"
	+ "19a4c116b8d2d0c81e376c085141ab532748774cdf8eeb9934b0bcb5e19b48a8"
	+ "391c0cb3c5c95a634ed8aa4ae3418acb5b9cca4f7763e373682e6ff3d6b2b8a3"
	+ "748f82ee5defb2fc78a5636f43172f6084c87814a1f0ab728cc702081a6439ec"
	+ "90befffa23631e28a4506cebde82bde9bef9a3f7b2c67915c67178f2e372532b"
	+ "ca273eceea26619cd186b8c721c0c207eada7dd6cde0eb1ef57d4f7fee6ed178"
	+ "06f067aa72176fba0a637dc5a2c898a6113f9804bef90dae1b710b35131c471b"
	+ "28db77f523047d8432caab7b40c724933c9ebe0a15c9bebc431d67c49c100d4c"
	+ "4cc5d4becb3e42b6597f299cfc657e2a5fcb6fab3ad6faec6c44198c4a475817"
)
## The same of the square roots of the first 8.
const START_WORDS := (
	"6a09e667f3bcc908bb67ae8584caa73b3c6ef372fe94f82ba54ff53a5f1d36f1"
	+ "510e527fade682d19b05688c2b3e6c1f1f83d9abfb41bd6b5be0cd19137e2179"
)


## The 64 bytes of the hash.
static func of(data: PackedByteArray) -> PackedByteArray:
	var state := _words(START_WORDS.hex_decode(), 0, 8)
	var rounds := _words(ROUND_WORDS.hex_decode(), 0, 80)
	var padded := _padded(data)
	for start in range(0, padded.size(), BLOCK_BYTES):
		_add_block(state, _schedule(padded, start), rounds)
	var out := PackedByteArray()
	out.resize(64)
	for place in 8:
		for byte in 8:
			out[8 * place + byte] = (state[place] >> (56 - 8 * byte)) & 255
	return out


static func _padded(data: PackedByteArray) -> PackedByteArray:
	var padded := data.duplicate()
	padded.append(0x80)
	var zeros := posmod(BLOCK_BYTES - 16 - padded.size(), BLOCK_BYTES) + 8
	padded.resize(padded.size() + zeros + 8)
	for place in range(data.size() + 1, padded.size()):
		padded[place] = 0
	var bits := 8 * data.size()
	for byte in 8:
		padded[padded.size() - 1 - byte] = (bits >> (8 * byte)) & 255
	return padded


static func _words(bytes: PackedByteArray, start: int, count: int) -> PackedInt64Array:
	var words := PackedInt64Array()
	for place in count:
		var word := 0
		for byte in 8:
			word = (word << 8) | bytes[start + 8 * place + byte]
		words.append(word)
	return words


static func _schedule(padded: PackedByteArray, start: int) -> PackedInt64Array:
	var words := _words(padded, start, 16)
	for place in range(16, 80):
		var low := words[place - 15]
		var high := words[place - 2]
		var sigma0 := _turned(low, 1) ^ _turned(low, 8) ^ _shifted(low, 7)
		var sigma1 := _turned(high, 19) ^ _turned(high, 61) ^ _shifted(high, 6)
		words.append(words[place - 16] + sigma0 + words[place - 7] + sigma1)
	return words


static func _add_block(state: PackedInt64Array, words: PackedInt64Array, rounds: PackedInt64Array) -> void:
	var a := state[0]
	var b := state[1]
	var c := state[2]
	var d := state[3]
	var e := state[4]
	var f := state[5]
	var g := state[6]
	var h := state[7]
	for place in 80:
		var sum1 := _turned(e, 14) ^ _turned(e, 18) ^ _turned(e, 41)
		var first := h + sum1 + ((e & f) ^ (~e & g)) + rounds[place] + words[place]
		var sum0 := _turned(a, 28) ^ _turned(a, 34) ^ _turned(a, 39)
		var second := sum0 + ((a & b) ^ (a & c) ^ (b & c))
		h = g
		g = f
		f = e
		e = d + first
		d = c
		c = b
		b = a
		a = first + second
	var added := [a, b, c, d, e, f, g, h]
	for place in 8:
		state[place] += added[place]


## Rotation to the right of 64 bits.
static func _turned(word: int, count: int) -> int:
	return _shifted(word, count) | (word << (64 - count))


## Shift to the right with zeros, where >> copies the sign.
static func _shifted(word: int, count: int) -> int:
	return (word >> count) & ((1 << (64 - count)) - 1)
