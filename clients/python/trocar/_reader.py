"""A strict YAML reader. Its error messages give the file and line and say how to fix the problem."""
from __future__ import annotations

import math
from typing import Any, Sequence

from ._files import open_input


class Reader:
    """A YAML document that is read key by key. Error messages give file and line."""

    def __init__(self, path: str, kind: str, error: type[Exception], keys: str):
        """kind: what the file is, such as "plan", and keys: what keys it has; both are for messages. error: the exception class to raise."""
        self.path, self.kind, self.error, self.keys = path, kind, error, keys
        try:
            import yaml
        except ImportError as missing:
            raise error(f"{path}: reading a {kind} needs Debian's python3-yaml: {missing}") from missing
        self.yaml = yaml
        try:
            with open_input(path, encoding="utf-8") as file:
                self.source = file.read()
            root = yaml.compose(self.source, Loader=yaml.SafeLoader)
        except OSError as fault:
            raise error(f"{path}: cannot be opened: {fault.strerror}") from fault
        except UnicodeDecodeError as fault:
            raise error(f"{path}: not a text file in UTF-8") from fault
        except yaml.MarkedYAMLError as fault:
            mark = fault.problem_mark or fault.context_mark
            raise error(f"{path}:{mark.line + 1 if mark else 1}: not YAML: {fault.problem or fault.context}") from fault
        except yaml.YAMLError as fault:
            raise error(f"{path}: not YAML: {fault}") from fault
        except RecursionError as fault:
            raise error(f"{path}: lists within lists, too deep for a {kind}") from fault
        if root is None:
            raise error(f"{path}:1: empty: a {kind} has {keys}")
        self.root = root

    def fail(self, node: Any, words: str) -> Exception:
        return self.error(f"{self.path}:{self.line(node)}: {words}")

    @staticmethod
    def line(node: Any) -> int:
        return node.start_mark.line + 1

    def mapping(self, node: Any, place: str, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, Any]:
        known = (*required, *optional)
        if not isinstance(node, self.yaml.MappingNode):
            raise self.fail(node, f"{place or 'a ' + self.kind}: write keys and values: {', '.join(known)}")
        found: dict[str, Any] = {}
        for key, value in node.value:
            name = str(key.value)
            if name not in known:
                raise self.fail(key, f"{place + ': ' if place else ''}unknown key \"{name}\": there are {', '.join(known)}")
            if name in found:
                raise self.fail(key, f"{place + ': ' if place else ''}\"{name}\" is given twice: remove one")
            found[name] = value
        for name in required:
            if name not in found:
                raise self.fail(node, f"{place + ': ' if place else ''}missing key \"{name}\"")
        return found

    def items(self, node: Any, place: str) -> list[Any]:
        if not isinstance(node, self.yaml.SequenceNode):
            raise self.fail(node, f"{place}: write a list")
        return node.value

    def text(self, node: Any, place: str) -> str:
        if not isinstance(node, self.yaml.ScalarNode) or not node.value.strip():
            raise self.fail(node, f"{place}: write a name")
        return node.value.strip()

    def number(self, node: Any, place: str, least: float = 0.0, inclusive: bool = False) -> float:
        """Reads a number greater than `least`, or at least `least` if `inclusive`. Converts the text itself, because YAML 1.1 takes 5e-3 for a string."""
        try:
            value = float(node.value) if isinstance(node, self.yaml.ScalarNode) else math.nan
        except ValueError:
            value = math.nan
        if not ((value > least or (inclusive and value == least)) and math.isfinite(value)):
            given = f"\"{node.value}\"" if isinstance(node, self.yaml.ScalarNode) else "a list"
            limit = "" if math.isinf(least) else f" of {least:g} or above" if inclusive else f" above {least:g}"
            raise self.fail(node, f"{place}: {given}: write a number{limit}")
        return value

    def numbers(self, node: Any, place: str, count: int, least: float = -math.inf) -> list[float]:
        items = self.items(node, place)
        if len(items) != count:
            raise self.fail(node, f"{place}: {len(items)} numbers: write {count}")
        return [self.number(item, f"{place}[{i}]", least) for i, item in enumerate(items)]

    def count(self, node: Any, place: str, most: int = 100, least: int = 1) -> int:
        value = self.number(node, place, -math.inf)
        if value != int(value) or not least <= value <= most:
            raise self.fail(node, f"{place}: \"{node.value}\": write a whole number from {least} to {most}")
        return int(value)
