#!/usr/bin/python3
"""Parses trocar.lcm, which is the only place where the flags and events are defined and described.

Run as a program, it writes the C header with their names: message_types.py trocar.lcm message_words.h
"""
import re
import sys
from typing import NamedTuple


class Line(NamedTuple):
    """A field, or a constant if it has a value."""

    type: str
    name: str     # including the dimensions of an array
    value: int | None
    doc: str


class Struct(NamedTuple):
    name: str
    doc: str
    lines: list[Line]

    def fields(self):
        return [line for line in self.lines if line.value is None]

    def constants(self):
        return [line for line in self.lines if line.value is not None]


def read(path):
    """Returns the comment at the top of the file, and the list of its structs."""
    head, structs, comment, inside = None, [], [], False
    with open(path, encoding="utf-8") as file:
        for text in file:
            code, _, doc = (part.strip() for part in text.partition("//"))
            if code in ("{", "}"):
                inside = code == "{"
            elif not code and doc and inside:   # continues the comment on the line above
                structs[-1].lines[-1] = structs[-1].lines[-1]._replace(doc=f"{structs[-1].lines[-1].doc} {doc}")
            elif not code and doc:
                comment.append(doc)
            elif code.startswith("package"):
                head, comment = " ".join(comment), []
            elif match := re.fullmatch(r"struct (\w+)", code):
                structs.append(Struct(match[1], " ".join(comment), []))
                comment = []
            elif match := re.fullmatch(r"const (\w+) (\w+) = (-?\w+);", code):
                structs[-1].lines.append(Line(match[1], match[2], int(match[3], 0), doc))
            elif match := re.fullmatch(r"(\w+) (\w+(?:\[\w+\])*);", code):
                structs[-1].lines.append(Line(match[1], match[2], None, doc))
            elif code:
                sys.exit(f"{path}: neither a field nor a constant: {code}")
    return head, structs


def flags_and_events(structs):
    """Returns two dictionaries from bit to lower-case name: the flags and the events."""
    constants = next(s for s in structs if s.name == "needle_wrench_t").constants()
    events = {c.value: c.name[6:].lower() for c in constants if c.name.startswith("EVENT_")}
    flags = {c.value: c.name.lower() for c in constants if not c.name.startswith("EVENT_")}
    return flags, events


def header(structs):
    lines = ["/* Made of trocar.lcm: names of the bits of flags and events in needle_wrench_t. */",
             "typedef struct { int bit; const char *word; } message_word;"]
    for name, words in zip(("flag_words", "event_words"), flags_and_events(structs)):
        lines += [f"static const message_word {name}[] = {{"] + [f'    {{{bit}, "{word}"}},' for bit, word in words.items()] + ["};"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    with open(sys.argv[2], "w", encoding="utf-8") as out:
        out.write(header(read(sys.argv[1])[1]))
