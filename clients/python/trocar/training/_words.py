"""Report texts in the trainee's language, from words/*.json in this folder. To add a language, add a file there."""
from __future__ import annotations

import json
from pathlib import Path

from ._measures import shown

FOLDER = Path(__file__).parent / "words"
ENGLISH = "en"


def languages() -> list[str]:
    """Returns the codes of the available languages, English first."""
    return [ENGLISH, *sorted(path.stem for path in FOLDER.glob("*.json") if path.stem != ENGLISH)]


class Words:
    """The texts in one language, falling back to English where a text is missing."""

    def __init__(self, language: str = ENGLISH) -> None:
        self.language = language if language in languages() else ENGLISH
        self._texts: dict[str, str] = {key: text for code in (ENGLISH, self.language) for key, text in json.loads((FOLDER / f"{code}.json").read_text(encoding="utf-8")).items()}

    def __call__(self, key: str, **values: object) -> str:
        """Returns the text for a key, with placeholders such as {count} filled in from `values`."""
        return self._texts[key].format(**values)

    def limit(self, measure: str, least: float | None, most: float | None) -> str:
        """Puts a limit on a measure into words. Either `least` or `most` is None."""
        return self("limit.most", limit=shown(measure, most)) if least is None else self("limit.least", limit=shown(measure, least))
