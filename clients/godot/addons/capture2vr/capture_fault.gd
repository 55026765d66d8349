class_name CaptureFault
extends RefCounted
## Why something cannot be shown: a code for programs, and a sentence for people.

## The file has other bytes than its catalogue says: damaged on the way, or tampered with.
const FILE_CHANGED := "FILE_CHANGED"
## The server has no such file.
const FILE_MISSING := "FILE_MISSING"
## No answer, or one that is no success. Worth another try.
const UNREACHABLE := "UNREACHABLE"
## The server wants to know who asks, and does not let this one in: [member CaptureCollection.headers].
const ACCESS_REFUSED := "ACCESS_REFUSED"
## The device cannot keep the file: its storage is full or closed.
const STORAGE_FAILED := "STORAGE_FAILED"
## The file is whole, and no mesh can be made of it.
const MESH_INVALID := "MESH_INVALID"
## A catalogue that is cut off, or a file that is none.
const CATALOGUE_TRUNCATED := "CATALOGUE_TRUNCATED"
## The catalogue of another collection.
const CATALOGUE_OTHER := "CATALOGUE_OTHER"
## An older version than this device has seen.
const CATALOGUE_OLDER := "CATALOGUE_OLDER"
## Nobody signed the catalogue, and this app asks for a signature.
const SIGNATURE_MISSING := "SIGNATURE_MISSING"
## The signature belongs to another text.
const SIGNATURE_WRONG := "SIGNATURE_WRONG"
## Signed, but by none of the keys that this app believes.
const KEY_UNKNOWN := "KEY_UNKNOWN"
## There is no collection to take the asset from.
const COLLECTION_CLOSED := "COLLECTION_CLOSED"
## The collection does not have the asset.
const ASSET_UNKNOWN := "ASSET_UNKNOWN"
## The asset was taken out of sight.
const ASSET_REMOVED := "ASSET_REMOVED"

## One of the constants of this class.
var code: String
## What went wrong with what, and what to do about it.
var message: String


func _init(new_code: String, what: String, hint := "") -> void:
	code = new_code
	message = what if hint.is_empty() else "%s. %s" % [what, hint]


func _to_string() -> String:
	return "%s: %s" % [code, message]
