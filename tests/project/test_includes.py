#!/usr/bin/env python3
"""The mechanics have no circular includes, neither between files (a .c and its .h count as one) nor between folders; only kernels, and
headers and sources of linalg, include vector types."""
import pathlib
import re
import sys


def includes(root):
    """Returns the units (paths without suffix) that each unit includes."""
    files = {path.relative_to(root).as_posix(): path for path in root.rglob('*.[ch]')}
    graph = {}
    for name, path in files.items():
        found = re.findall(r'^\s*#\s*include\s+"([^"]+)"', path.read_text(), re.MULTILINE)
        graph.setdefault(name[:-2], set()).update(other[:-2] for other in found if other in files and other[:-2] != name[:-2])
    return graph


def by_folder(graph):
    def folder(unit):
        return unit.rpartition('/')[0] or unit  # trocar.h, which all may include, has no folder
    folders = {}
    for unit, others in graph.items():
        folders.setdefault(folder(unit), set()).update(folder(other) for other in others if folder(other) != folder(unit))
    return folders


def circles(graph):
    """Yields circles, found by depth-first search: a circle is an edge to a node that is still open."""
    found, state, way = [], {}, []

    def visit(node):
        state[node] = 'open'
        way.append(node)
        for other in sorted(graph.get(node, ())):
            if state.get(other) == 'open':
                found.append(way[way.index(other):] + [other])
            elif other not in state:
                visit(other)
        way.pop()
        state[node] = 'done'

    for node in sorted(graph):
        if node not in state:
            visit(node)
    return found


VECTORS = {f'linalg/{name}' for name in ('simd4', 'simd_wide', 'vec_simd4', 'row_matrix')}


def leaks(graph):
    """Returns units outside linalg that include vector types and are not kernels."""
    return sorted(unit for unit, others in graph.items() if others & VECTORS and not unit.startswith('linalg/') and not unit.endswith('_kernels'))


def main():
    assert circles({'a': {'b'}, 'b': {'c'}, 'c': {'a'}}) == [['a', 'b', 'c', 'a']] and not circles({'a': {'b', 'c'}, 'b': {'c'}})
    graph = includes(pathlib.Path(sys.argv[1]))
    assert len(graph) > 40, f'only {len(graph)} files under {sys.argv[1]}'
    bad = circles(graph) + circles(by_folder(graph))
    assert leaks({'a/b': {'linalg/simd4'}, 'a/c_kernels': {'linalg/simd4'}, 'linalg/d': {'linalg/simd4'}}) == ['a/b']
    assert all(unit in graph for unit in VECTORS), f'{VECTORS - set(graph)} have gone'
    leaking = leaks(graph)
    for unit in leaking:
        print(f'vector types outside of kernels: {unit}', file=sys.stderr)
    for circle in bad:
        print('include circle: ' + ' -> '.join(circle), file=sys.stderr)
    print(f'{len(graph)} files, {len(by_folder(graph))} folders, {len(bad)} circles')
    return 1 if bad or leaking else 0


if __name__ == '__main__':
    sys.exit(main())
