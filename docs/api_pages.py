"""Write the HTTP API as Markdown pages, from the gateway's OpenAPI document: one per group of routes, and schemas."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.memory import MemoryStore

GROUPS = {
    "captures": "Upload captures, in one request or in parts; list, download and delete them.",
    "jobs": "Reconstruct a capture, follow the progress, cancel, or run it again with other options.",
    "assets": "Read assets, their levels of detail, versions, downloads and notes; rename and hide them.",
    "collections": "Search collections and get the public keys that sign them.",
    "visibility": "Say who may read an asset or a collection.",
    "shares": "Links that open an asset, a collection or an arrangement without a login.",
    "scenes": "Saved arrangements of objects in VR, which several people may move at once.",
    "access": "Sessions, pairing, access keys, tenants, limits, and the state of the service.",
    "webhooks": "Have your server told when jobs end and assets change.",
    "data": "Export, delete, retain, and see who did what.",
    "health": "Whether the gateway lives and is ready; metrics.",
    "pages": "The addresses of the web pages.",
}
"""Tag of the OpenAPI document -> what its page says first."""
PAGES = ("index.md", "schemas.md", *(f"{group}.md" for group in GROUPS))
_PROBLEM = "application/problem+json"


def openapi_document() -> dict[str, Any]:
    """The document that a gateway with default settings serves at /openapi.json."""
    return create_app(GatewaySettings(), MemoryStore()).openapi()


def api_pages() -> Iterator[tuple[str, str]]:
    """File name and Markdown of each page of the API. Raises KeyError for a group that GROUPS does not know."""
    document = openapi_document()
    groups: dict[str, list[str]] = {name: [] for name in GROUPS}
    index: dict[str, list[str]] = {name: [] for name in GROUPS}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            (group,) = operation["tags"]
            groups[group].append(_route(method, path, operation))
            index[group].append(_row(group, method, path, operation))
    for group, routes in groups.items():
        yield f"{group}.md", f"# {group.capitalize()}\n\n{GROUPS[group]}\n\n" + "\n".join(routes)
    yield "schemas.md", _schemas_page(document["components"]["schemas"])
    yield "index.md", _index_page(index)


def _index_page(index: dict[str, list[str]]) -> str:
    parts = [
        "# All routes",
        "",
        "Made from the gateway's own `/openapi.json`, so it is what this version does.",
        "[The ten usual calls](../api.md) come with curl, Python and JavaScript.",
        "Errors are problem documents, whose codes [Troubleshooting](../troubleshooting.md) explains.",
    ]
    for group, rows in index.items():
        parts += ["", f"## {group.capitalize()}", "", GROUPS[group], ""]
        parts += ["| route | what it does | scope |", "|---|---|---|", *rows]
    return "\n".join(parts) + "\n"


def _row(group: str, method: str, path: str, operation: dict[str, Any]) -> str:
    first = operation.get("description", operation["summary"]).split(". ")[0].split("\n\n")[0].replace("\n", " ")
    link = f"[`{method.upper()} {path}`]({group}.md#{_anchor(method, path)})"
    return f"| {link} | {_cell(first)} | {_scopes(operation)} |"


def _route(method: str, path: str, operation: dict[str, Any]) -> str:
    lines = [f"## `{method.upper()} {path}` {{ #{_anchor(method, path)} }}", "", operation.get("description", ""), ""]
    if scopes := _scopes(operation):
        word = "one of the scopes" if "," in scopes else "the scope"
        lines += [f"Needs an access key with {word} {scopes}, once the gateway has keys.", ""]
    if parameters := operation.get("parameters"):
        lines += ["| parameter | in | type | meaning |", "|---|---|---|---|"]
        lines += [_parameter(each) for each in parameters] + [""]
    for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
        lines += [f"**Body**, `{media_type}`: {_type(content.get('schema', {}))}", ""]
    lines += ["| answer | body |", "|---|---|", *_answers(operation["responses"]), ""]
    return "\n".join(lines)


def _parameter(parameter: dict[str, Any]) -> str:
    need = "" if parameter.get("required") else ", optional"
    kind = _type(parameter.get("schema", {}))
    return f"| `{parameter['name']}` | {parameter['in']} | {kind}{need} | {_cell(parameter.get('description', ''))} |"


def _answers(responses: dict[str, Any]) -> Iterator[str]:
    problems = []
    for status, response in sorted(responses.items()):
        content = response.get("content", {})
        if _PROBLEM in content:
            problems.append(status)
        elif status != "422":  # FastAPI's own schema of it, which this gateway answers as a problem too
            kinds = {_type(each.get("schema", {})) for each in content.values()} - {"any"}
            yield f"| {status} | {', '.join(sorted(kinds)) or '–'} |"
    if problems:
        yield f"| {', '.join(problems)} | [ProblemView](schemas.md#problemview) |"


def _schemas_page(schemas: dict[str, Any]) -> str:
    parts = ["# Schemas", "", "The bodies of requests and answers.", ""]
    for name, schema in sorted(schemas.items(), key=lambda item: _short(item[0])):
        parts += [f"## {_short(name)} {{ #{_short(name).lower()} }}", "", schema.get("description", ""), ""]
        if schema.get("enum"):
            parts += ["One of " + ", ".join(f"`{each}`" for each in schema["enum"]) + ".", ""]
        if schema.get("properties"):
            required = schema.get("required", ())
            parts += ["| field | type | meaning |", "|---|---|---|"]
            parts += [_field(field, each, field in required) for field, each in schema["properties"].items()] + [""]
        if "example" in schema:
            parts += ["```json", json.dumps(schema["example"], indent=2, ensure_ascii=False), "```", ""]
    return "\n".join(parts)


def _field(name: str, schema: dict[str, Any], required: bool) -> str:
    need = "" if required or "default" in schema else ", optional"
    default = f" Default: `{json.dumps(schema['default'])}`." if schema.get("default") not in (None, "", [], {}) else ""
    return f"| `{name}` | {_type(schema)}{need} | {_cell(schema.get('description', ''))}{default} |"


def _type(schema: dict[str, Any]) -> str:
    """A schema's type in a few words, with a link where it has a section of its own."""
    if "$ref" in schema:
        name = _short(schema["$ref"].rpartition("/")[2])
        return f"[{name}](schemas.md#{name.lower()})"
    if choices := schema.get("anyOf") or schema.get("allOf"):
        return " or ".join(dict.fromkeys(_type(each) for each in choices))
    if "enum" in schema:
        return " or ".join(f"`{each}`" for each in schema["enum"] if each != "")
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return str(schema.get("type", "any"))


def _short(name: str) -> str:
    """Shorten what FastAPI calls one of two models of one name: `…__routes__access__KeyView` -> `AccessKeyView`."""
    parts = name.split("__")
    return f"{parts[-2].capitalize()}{parts[-1]}" if len(parts) > 1 else name


def _scopes(operation: dict[str, Any]) -> str:
    return ", ".join(f"`{scope}`" for scope in operation.get("x-scopes", ()))


def _anchor(method: str, path: str) -> str:
    return "-".join([method, *re.findall(r"[\w-]+", path)])


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
