"""Finds clusters of pieces in a label image whose surfaces are connected.

CGAL finds surfaces by shooting a few random rays and follows them from there, so it may miss a surface that is not connected to any other, such as that of a
lesion inside an organ. Clusters are therefore extracted one by one, each from its own section of the image, where the rays cannot miss it.

In a graph whose edges join pieces that touch, two edges belong to the same cluster if they lie on a common cycle; the surfaces of a cluster meet along lines.
A piece that encloses others is in several clusters: it is the inside of one and the outside of the others.
"""
import collections
import dataclasses

import numpy as np

from .label_image import pairs_in

AROUND = 0               # number of the tissue (or air) around all pieces; piece k has number k + 1


@dataclasses.dataclass
class Cluster:
    outer: int               # number of the piece that surrounds the cluster
    inner: list              # numbers of the other pieces
    stands: dict             # maps numbers in the cluster to themselves, and all others to the number in the cluster that they are attached to
    edges: set               # pairs of numbers whose common surface is part of the cluster


def neighbours_in(numbers):
    """Returns {number: set of numbers that it touches} for an image of numbered pieces."""
    pairs = []
    for axis in range(3):
        one, other = np.take(numbers, range(1, numbers.shape[axis]), axis), np.take(numbers, range(numbers.shape[axis] - 1), axis)
        apart = one != other
        pairs.append(pairs_in(one[apart], other[apart])[0])
    found = collections.defaultdict(set)
    for a, b in np.unique(np.vstack(pairs), axis=0).tolist():
        found[a].add(b)
        found[b].add(a)
    return dict(found)


def edges_in_circles(graph, root):
    """Returns the edge sets of a connected graph's biconnected components (Hopcroft and Tarjan 1973)."""
    depth, low, found, stack = {root: 0}, {root: 0}, [], []
    way = [(root, None, iter(sorted(graph[root])))]
    while way:
        node, parent, others = way[-1]
        for other in others:
            if other == parent:
                continue
            if other not in depth:
                stack.append((node, other))
                depth[other] = low[other] = depth[node] + 1
                way.append((other, node, iter(sorted(graph[other]))))
                break
            if depth[other] < depth[node]:
                stack.append((node, other))
                low[node] = min(low[node], depth[other])
        else:
            way.pop()
            if parent is None:
                continue
            low[parent] = min(low[parent], low[node])
            if low[node] >= depth[parent]:
                at = stack.index((parent, node))
                found.append(stack[at:])
                del stack[at:]
    return found


def clusters_of(graph):
    """Returns the clusters, each after the one that encloses it."""
    found = [cluster_of(graph, {frozenset(edge) for edge in edges}) for edges in edges_in_circles(graph, AROUND)]
    return sorted(found, key=lambda each: distance_in(graph, each.outer))


def cluster_of(graph, edges):
    mine = set().union(*edges)
    stands = hanging_on(graph, mine, edges)
    return Cluster(stands[AROUND], sorted(mine - {stands[AROUND]}), stands, edges)


def joined(graph, clusters, pairs):
    """Merges clusters, given pairs of their indices, and returns the result."""
    groups = [{k} for k in range(len(clusters))]
    for a, b in pairs:
        one, other = (next(group for group in groups if k in group) for k in (a, b))
        if one is not other:
            one |= other
            groups.remove(other)
    found = [clusters[min(group)] if len(group) == 1 else cluster_of(graph, set().union(*(clusters[k].edges for k in group))) for group in groups]
    return sorted(found, key=lambda each: distance_in(graph, each.outer))


def hanging_on(graph, mine, edges):
    """Maps every node to the cluster's node from which it can be reached without using the cluster's edges."""
    stands = {node: node for node in mine}
    way = list(mine)
    while way:
        node = way.pop()
        for other in graph[node]:
            if other not in stands and frozenset((node, other)) not in edges:
                stands[other] = stands[node]
                way.append(other)
    return stands


def distance_in(graph, node):
    """Returns the number of steps from AROUND to a node."""
    seen, level, steps = {AROUND}, {AROUND}, 0
    while node not in level:
        level = {other for each in level for other in graph[each]} - seen
        seen |= level
        steps += 1
    return steps
