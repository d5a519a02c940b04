#!/usr/bin/env python3
"""Tests the structure of the source tree:

- Core, server and clients have no circular includes, neither between files (a .c and its .h count as one) nor between folders.
- A folder of core includes only folders above it in the table in core/README.md. The tick (core/insertion) includes none of those that only the worker calls.
  Inside core/insertion and core/api, the tables in their READMEs give the order in the same way.
- Clients include only common/ and intake/ of server/. Only kernels and linalg include vector types.
- No folder has more than 25 files, and each of core, lcmtypes, server, clients and tests has a README of at most 150 lines.

usage: test_includes.py SOURCE_DIR
"""
import collections
import pathlib
import re
import subprocess
import sys


def includes(root, *parts):
    """Returns the units (paths relative to root, without suffix) that each unit includes; if parts are given, only units in these parts."""
    files = {path.relative_to(root).as_posix(): path for part in parts or ('.',) for path in (root / part).rglob('*.[ch]') if 'node_modules' not in path.parts}
    graph = {}
    for name, path in files.items():
        found = re.findall(r'^\s*#\s*include\s+"([^"]+)"', path.read_text(), re.MULTILINE)
        beside = name.rpartition('/')[0]
        named = [next((file for file in (f'{beside}/{other}', other, *(f'{part}/{other}' for part in parts or ('include',))) if file in files), None) for other in found]
        graph.setdefault(name[:-2], set()).update(file[:-2] for file in named if file and file[:-2] != name[:-2])
    return graph


def by_folder(graph):
    def folder(unit):
        return unit.rpartition('/')[0] or unit
    folders = {}
    for unit, others in graph.items():
        folders.setdefault(folder(unit), set()).update(folder(other) for other in others if folder(other) != folder(unit))
    return folders


def circles(graph):
    """Yields cycles, found by depth-first search: a cycle is an edge to a node that is still being visited."""
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


def floors(readme):
    """Returns {name: row} for the folders or files in the README's first table, which lists the lowest level first."""
    table = re.search(r'^\| (?:folder|file)[^|]*\|.*\n\|[-| ]+\n((?:\|.*\n)+)', readme, re.MULTILINE)[1]
    return {name: row for row, line in enumerate(table.splitlines()) for name in re.findall(r'`(\w+)(?:\.h)?`', line.split('|')[1])}


def parts_of(graph, folder):
    """Returns {unit: part} for the units in a folder (empty: the root). A part is a subfolder, or a file that is not in one."""
    return {unit: unit[len(folder):].split('/')[0] for unit in graph if unit.startswith(folder)}


def upward(graph, order, folder=''):
    """Returns the #include lines with which a file in one part of the folder includes a file in a higher part."""
    part = {unit: name for unit, name in parts_of(graph, folder).items() if name in order}
    return [f'{unit} includes {other}, which is below it in the table of core/{folder}README.md' for unit in sorted(part)
            for other in sorted(graph[unit]) if other in part and order[part[other]] > order[part[unit]]]


WORKERS = ('inverse/', 'condensed/', 'remesh/', 'probe/', 'resting/')     # folders of core that only the worker calls


def from_tick(graph):
    """Returns the #include lines in core/insertion that pull in headers from the worker's folders."""
    return [f'{unit} includes {other}, which only the worker calls' for unit in sorted(graph) if unit.startswith('insertion/')
            for other in sorted(graph[unit]) if other.startswith(WORKERS)]


SHARED = ('server/common/', 'server/intake/')   # the parts of the server that clients may include


def reaching(graph):
    """Returns the #include lines in clients that pull in the server's private files, and those in the server that pull in clients' files."""
    return [f'{unit} includes {other}' for unit in sorted(graph) for other in sorted(graph[unit])
            if unit.split('/')[0] != other.split('/')[0] and not (unit.startswith('clients/') and other.startswith(SHARED))]


MOST_FILES, MOST_LINES = 25, 150


def crowded(files):
    """Returns the folders that have more than MOST_FILES of these files."""
    counts = collections.Counter(file.rpartition('/')[0] or '.' for file in files)
    return [f'{folder} has {count} files; at most {MOST_FILES}' for folder, count in sorted(counts.items()) if count > MOST_FILES]


def undescribed(root, files):
    """Returns which of core, lcmtypes, server, clients, tests and their folders have no README, or one that is too long."""
    faults = []
    for folder in sorted({match[0] for match in (re.match(r'(core|lcmtypes|server|clients|tests)(/[^/]+(?=/))?', file) for file in files) if match}):
        readme = root / folder / 'README.md'
        if not readme.is_file():
            faults.append(f'{folder} has no README.md')
        elif len(readme.read_text().splitlines()) > MOST_LINES:
            faults.append(f'{folder}/README.md has more than {MOST_LINES} lines')
    return faults


VECTORS = {f'linalg/{name}' for name in ('simd4', 'simd_wide', 'vec_simd4', 'row_matrix')}


def leaks(graph):
    """Returns units outside linalg that include vector types and are not kernels."""
    return sorted(unit for unit, others in graph.items() if others & VECTORS and not unit.startswith('linalg/') and not unit.endswith('_kernels'))


def main():
    assert circles({'a': {'b'}, 'b': {'c'}, 'c': {'a'}}) == [['a', 'b', 'c', 'a']] and not circles({'a': {'b', 'c'}, 'b': {'c'}})
    assert leaks({'a/b': {'linalg/simd4'}, 'a/c_kernels': {'linalg/simd4'}, 'linalg/d': {'linalg/simd4'}}) == ['a/b']
    assert floors('| file | x |\n|---|---|\n| `a.h` | |\n| [`b`](b), `c` | `d` |\n\n| file | y |\n') == {'a': 0, 'b': 1, 'c': 1}
    upside_down = {'a/x/f': {'a/y', 'trocar'}, 'a/y': {'a/x/f'}}
    assert upward(upside_down, {'x': 0, 'y': 1}, 'a/') == ['a/x/f includes a/y, which is below it in the table of core/a/README.md']
    assert upward(upside_down, {'y': 0, 'x': 1}, 'a/') == ['a/y includes a/x/f, which is below it in the table of core/a/README.md']
    assert reaching({'clients/a/b': {'server/haptic', 'server/common/eventfd_signal', 'clients/c/d'}, 'server/io': {'clients/a/b', 'server/haptic'}}) == [
        'clients/a/b includes server/haptic', 'server/io includes clients/a/b']
    assert from_tick({'insertion/a/b': {'inverse/c', 'tissue/d'}, 'api/e': {'inverse/c'}}) == ['insertion/a/b includes inverse/c, which only the worker calls']
    assert crowded([f'a/{i}' for i in range(MOST_FILES)] + ['a/b/c']) == [] and len(crowded([f'a/{i}' for i in range(MOST_FILES + 1)])) == 1
    root = pathlib.Path(sys.argv[1])

    core = includes(root / 'core')
    assert len(core) > 40, f'only {len(core)} files in core'
    assert all(unit in core for unit in VECTORS), f'{VECTORS - set(core)} have gone'
    faults = []
    for folder in '', 'insertion/', 'api/':
        order = floors((root / 'core' / folder / 'README.md').read_text())
        listed = {name for unit, name in parts_of(core, folder).items() if folder or '/' in unit}
        assert set(order) == listed, f'the table in core/{folder}README.md differs from the folder in {set(order) ^ listed}'
        faults += upward(core, order, folder)
    faults += from_tick(core)
    programs = includes(root, 'server', 'clients')
    assert len(programs) > 60 and any(other.startswith(SHARED) for others in programs.values() for other in others), f'only {len(programs)} files in server and clients'

    faults += [f'vector types outside of kernels: {unit}' for unit in leaks(core)] + reaching(programs)
    rings = [circle for graph in (core, programs) for circle in circles(graph) + circles(by_folder(graph))]
    faults += ['include circle: ' + ' -> '.join(circle) for circle in rings]
    listed = subprocess.run(['git', '-C', root, 'ls-files'], capture_output=True, text=True, check=False)
    if listed.returncode == 0:  # succeeds in a Git checkout, where only tracked files count
        files = listed.stdout.splitlines()
        faults += crowded(files) + undescribed(root, files)
    for fault in faults:
        print(fault, file=sys.stderr)
    print(f'{len(core) + len(programs)} files, {len(by_folder(core)) + len(by_folder(programs))} folders, {len(rings)} circles')
    return 1 if faults else 0


if __name__ == '__main__':
    sys.exit(main())
