"""Which things are garments, of which season, and where they hang: words of labels and names, months, hemispheres."""

from __future__ import annotations

from typing import Any

from tests.support.page_scripts import PageScripts

SEASONS = ["spring", "summer", "autumn", "winter"]
_ASK = """async ([name, each]) => {
    const garments = await import('/web/catalogue/garments.js');
    return each.map((args) => garments[name](...args));
}"""
_SEASONS_OF_DAYS = """async (zone) => {
    const { seasonOf } = await import('/web/catalogue/garments.js');
    return Array.from({ length: 366 }, (_, day) => seasonOf(new Date(2028, 0, 1 + day, 12), zone));
}"""


def ask(scripts: PageScripts, name: str, *each: list[Any]) -> list[Any]:
    answers: list[Any] = scripts.evaluate(_ASK, [name, list(each)])
    return answers


def thing(label: str, *labels: str, state: str = "refined") -> dict[str, Any]:
    return {"key": label, "label": label, "labels": list(labels), "state": state}


def test_each_season_is_three_whole_months_and_the_south_is_half_a_year_away(scripts: PageScripts) -> None:
    north = scripts.evaluate(_SEASONS_OF_DAYS, "Europe/Berlin")
    assert [season for day, season in enumerate(north) if day == 0 or north[day - 1] != season] == [
        *("winter", "spring", "summer", "autumn", "winter"),
    ]
    for season in SEASONS:
        assert 90 <= north.count(season) <= 92
    assert north[31 + 29] == "spring"  # the first of March
    assert scripts.evaluate(_SEASONS_OF_DAYS, "Etc/Unknown") == north
    opposite = {"spring": "autumn", "summer": "winter", "autumn": "spring", "winter": "summer"}
    for zone in ("Australia/Sydney", "America/Argentina/Buenos_Aires", "Africa/Johannesburg", "Pacific/Auckland"):
        assert scripts.evaluate(_SEASONS_OF_DAYS, zone) == [opposite[season] for season in north], zone


def test_seasons_are_recognised_in_both_languages_whatever_their_case(scripts: PageScripts) -> None:
    named = {
        "spring": ["spring", "Spring 2026", "Frühling", "FRÜHJAHR", "fruehling", "Frühjahrsmode"],
        "summer": ["summer", "Sommer", "Sommerkleid", "high-summer", "sommer/2026"],
        "autumn": ["autumn", "fall", "Fall", "Herbst", "Herbstmantel"],
        "winter": ["Winter", "winterwear", "Wintermantel"],
    }
    for season, labels in named.items():
        assert ask(scripts, "seasonsOf", *([{"labels": [label]}] for label in labels)) == [[season]] * len(labels), (
            season
        )
    others = ["Falle", "fallen", "Springer", "offspring", "evening", "", "42", "{}"]
    assert ask(scripts, "seasonsOf", *([{"labels": [label]}] for label in others)) == [[]] * len(others)
    assert ask(scripts, "seasonsOf", [{"labels": ["Herbst", "spring"]}]) == [["spring", "autumn"]]


def test_words_say_from_where_a_garment_hangs(scripts: PageScripts) -> None:
    hanging = {
        "waist": ["Skirt", "Faltenrock", "Röcke", "Jeans", "Lederhose", "miniskirt"],
        "shoulders": [
            "Dress",
            "Abendkleid",
            "T-shirt",
            "Hemd",
            "Bluse",
            "winter coat",
            "Regenjacke",
            "dress, wide skirt",
            "jumpsuit",
            "Latzhose",
            "raincoat",
            "Hosenanzug",
        ],
        None: ["Truck", "Barock", "Teapot", "suitcase", "landscape", "harvest"],
    }
    for where, names in hanging.items():
        assert ask(scripts, "hangingOf", *([thing(name)] for name in names)) == [where] * len(names)
    assert ask(scripts, "hangingOf", [thing("IMG 332", "summer")], [thing("IMG 333", "wardrobe")]) == ["shoulders"] * 2


def test_a_choice_takes_what_bears_its_label_by_name_and_nothing_that_was_removed(scripts: PageScripts) -> None:
    things = [
        thing("Dress 10", "Sommer", "Evening"),
        thing("dress 9", "summer", "winter"),
        thing("Teapot", "evening"),
        thing("Coat", "winter", state="removed"),
        thing("Jeans"),
    ]
    chosen = ask(scripts, "chooseGarments", *([things, each] for each in [*SEASONS, "all", "label:EVENING"]))
    assert [[each["label"] for each in found] for found in chosen] == [
        [],
        ["dress 9", "Dress 10"],
        [],
        ["dress 9"],
        ["dress 9", "Dress 10", "Jeans"],
        ["Dress 10", "Teapot"],
    ]
    assert ask(scripts, "otherLabels", [things]) == [["evening"]], "seasons have their own choice; each label once"
