"""Understand the names of a table's columns: those of scanners, spreadsheets and survey software, in some languages."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

from capture2vr.order.reading import METRES, Unit

_WORDS = {
    "x": "x pointx posx positionx coordx coordinatex xcoord xcoordinate xkoordinate "
    "easting east e rechtswert rechts ost rw este est levante",
    "y": "y pointy posy positiony coordy coordinatey ycoord ycoordinate ykoordinate "
    "northing north n hochwert hoch nord hw norte",
    "z": "z pointz posz positionz coordz coordinatez zcoord zcoordinate zkoordinate "
    "height elevation elev altitude alt h hohe hoehe altura elevacion quota cota altezza hauteur level up",
    "red": "red r rot rouge rojo rosso vermelho rood diffusered colorr colourr colorred rgbr rgb0 rgba0 colors0 color0",
    "green": "green g grun gruen vert verde groen diffusegreen colorg colourg colorgreen rgbg rgb1 rgba1 colors1 "
    "color1",
    "blue": "blue b blau bleu azul blu blauw diffuseblue colorb colourb colorblue rgbb rgb2 rgba2 colors2 color2",
    "nx": "nx normalx normal0 normals0 normalsx n0",
    "ny": "ny normaly normal1 normals1 normalsy n1",
    "nz": "nz normalz normal2 normals2 normalsz n2",
    "intensity": "intensity i int intensitat intensite intensidad reflectance reflectivity remission scalarintensity",
    "latitude": "latitude lat breite breitengrad latitud latitudine",
    "longitude": "longitude lon long lng lange langengrad longitud longitudine",
    "rf": "rf",
    "gf": "gf",
    "bf": "bf",
}
_MEANING = {word: meaning for meaning, words in _WORDS.items() for word in words.split()}
_INDEXED = {
    f"{group}{number}": axis for group in ("points", "point", "position", "coords") for number, axis in enumerate("xyz")
}
_UNITS: dict[Unit, str] = {
    "m": "m meter metre meters metres",
    "mm": "mm millimeter",
    "cm": "cm centimeter",
    "ft": "ft feet foot",
    "us-ft": "ftus usft",
    "in": "in inch inches",
}
_METRES = {"km": 1e3} | {word: METRES[unit] for unit, words in _UNITS.items() for word in words.split()}
# Each of these costs no more than the length of a name, which may be a hostile line of 10,000 characters.
_BRACKETS = re.compile(r"[\[({<]([^\])}>]{0,40}+)[\])}>]")
_BEHIND = re.compile(rf"(?<![\s_/])[\s_/]++({'|'.join(_METRES)}|deg|degrees)\s*$", re.IGNORECASE)
"""A unit behind a name, as in "x_m", "X/mm" and "lon_deg"."""


def meaning_of(name: str) -> str:
    """Return what a column is: x, y, z, red, green, blue, nx, ny, nz, intensity, rf, gf, bf, latitude, longitude; or
    its own name in lower case, where that is none of these. Units in brackets or behind it are no part of a name."""
    for each in (_BRACKETS.sub("", name), _BEHIND.sub("", name)):
        if found := _MEANING.get(_word(each)) or _INDEXED.get(_word(each)):
            return found
    return name.strip().lower()


def metres_of(name: str) -> float | None:
    """Return the metres of the unit that a column's name has in brackets or behind it, as "X [mm]" and "x_mm" have;
    None without one."""
    found = _BRACKETS.search(name) or _BEHIND.search(name)
    return None if found is None else _METRES.get(_word(found.group(1)))


def meanings(names: Sequence[str]) -> list[str]:
    """Return what columns are. Of two that are the same the first one is; e, n and h are coordinates only together."""
    found = [meaning_of(name) for name in names]
    if not {"x", "y", "z"} <= {*found}:
        return found
    first: dict[str, int] = {}
    for number, each in enumerate(found):
        # A column that says x is x, whatever else means the same.
        if each not in first or (_word(names[number]) == each and _word(names[first[each]]) != each):
            first[each] = number
    return [each if first[each] == number else names[number].lower() for number, each in enumerate(found)]


def _word(name: str) -> str:
    """Return a name's letters and digits, in lower case and without accents."""
    plain = unicodedata.normalize("NFKD", name.replace("ß", "ss").replace("ø", "o")).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]", "", plain.lower())
