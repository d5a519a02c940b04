"""The texts of a report in the language of the trainee: words/*.json in this folder, in which others can be added."""
from __future__ import annotations

import json
from pathlib import Path

from ._measures import shown

FOLDER = Path(__file__).parent / "words"
ENGLISH = "en"


def languages() -> list[str]:
    """Returns the codes of the languages that have texts, English first."""
    return [ENGLISH, *sorted(path.stem for path in FOLDER.glob("*.json") if path.stem != ENGLISH)]


class Words:
    """The texts of a language; texts that are missing from its file are in English."""

    def __init__(self, language: str = ENGLISH) -> None:
        self.language = language if language in languages() else ENGLISH
        self._texts: dict[str, str] = {key: text for code in (ENGLISH, self.language) for key, text in json.loads((FOLDER / f"{code}.json").read_text(encoding="utf-8")).items()}

    def __call__(self, key: str, **values: object) -> str:
        """Returns the text with this key, with `values` in its placeholders, such as {count}."""
        return self._texts[key].format(**values)

    def limit(self, measure: str, least: float | None, most: float | None) -> str:
        """Returns a limit of a measure in words; one of the two is None."""
        return self("limit.most", limit=shown(measure, most)) if least is None else self("limit.least", limit=shown(measure, least))
