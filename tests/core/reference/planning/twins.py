"""The three planners once more, plain and slow: Python lists, full scans, costs summed from the root each time."""

import math

import numpy as np

from tests.core.reference.kernels import naive


def apart(a, b):
    return math.sqrt(sum((p - q) * (p - q) for p, q in zip(a, b, strict=True)))


def free(counter, grid, a, b):
    return naive.first_blocked(counter, grid, np.asarray(a), np.asarray(b), True) > 1.0


def nearest(nodes, target):
    squares = [sum((p - q) * (p - q) for p, q in zip(node, target, strict=True)) for node in nodes]
    return squares.index(min(squares))


def steer(source, target, max_step):
    away = apart(source, target)
    if away <= max_step:
        return list(target)
    return [s + (t - s) * (max_step / away) for s, t in zip(source, target, strict=True)]


class Sampler:
    def __init__(self, state, lower, upper):
        self.stream, self.box = naive.Xoshiro(state), list(zip(lower, upper, strict=True))

    def uniform(self):
        return [low + (high - low) * self.stream.uniform() for low, high in self.box]

    def towards(self, goal, bias):
        return list(goal) if self.stream.uniform() < bias else self.uniform()


def rrt(problem, max_step, goal_bias, iterations, random):
    """Nodes, parents, and the goal node or None."""
    counter, grid, start, goal, lower, upper = problem
    sampler = Sampler(random, lower, upper)
    nodes, parents = [list(start)], [-1]
    for _ in range(iterations):
        sample = sampler.towards(goal, goal_bias)
        source = nearest(nodes, sample)
        new = steer(nodes[source], sample, max_step)
        if free(counter, grid, nodes[source], new):
            nodes.append(new)
            parents.append(source)
            if new == list(goal):
                return nodes, parents, len(nodes) - 1
    return nodes, parents, None


def rrt_connect(problem, max_step, iterations, random):
    """Nodes of both trees, and whether they met."""
    counter, grid, start, goal, lower, upper = problem
    sampler = Sampler(random, lower, upper)
    trees = [list(start)], [list(goal)]
    for turn in range(iterations):
        mine, other = trees[turn % 2], trees[1 - turn % 2]
        sample = sampler.uniform()
        source = mine[nearest(mine, sample)]
        new = steer(source, sample, max_step)
        if not free(counter, grid, source, new):
            continue
        mine.append(new)
        source = other[nearest(other, new)]
        while source != new:
            step = steer(source, new, max_step)
            if not free(counter, grid, source, step):
                break
            other.append(step)
            source = step
        if source == new:
            return *trees, True
    return *trees, False


class StarTwin:
    """RRT*: every cost is the sum along the parents, so that nothing has to be passed on."""

    def __init__(self, problem, max_step, goal_bias, random):
        self.counter, self.grid, start, self.goal, lower, upper = problem
        self.max_step, self.goal_bias = max_step, goal_bias
        self.sampler = Sampler(random, lower, upper)
        volume = math.prod(high - low for low, high in zip(lower, upper, strict=True))
        self.gamma = 1.1 * (2 * (4 / 3) * volume / (4 / 3 * math.pi)) ** (1 / 3)
        self.nodes, self.parents, self.goal_node = [list(start)], [-1], None

    def cost(self, node):
        way = []
        while node > 0:
            way.append(apart(self.nodes[self.parents[node]], self.nodes[node]))
            node = self.parents[node]
        total = 0.0
        for step in reversed(way):
            total += step
        return total

    def step(self):
        if self.goal_node is None:
            sample = self.sampler.towards(self.goal, self.goal_bias)
        else:
            sample = self.sampler.uniform()
        source = nearest(self.nodes, sample)
        new = steer(self.nodes[source], sample, self.max_step)
        if new == self.nodes[source] or not free(self.counter, self.grid, self.nodes[source], new):
            return
        n = len(self.nodes) + 1
        radius = min(self.max_step, self.gamma * (math.log(n) / n) ** (1 / 3))
        near = [i for i, node in enumerate(self.nodes) if apart(node, new) <= radius]
        by_cost = sorted((self.cost(i) + apart(self.nodes[i], new), i) for i in near)
        parent, best = source, self.cost(source) + apart(self.nodes[source], new)
        for cost, i in by_cost:
            if cost < best and free(self.counter, self.grid, self.nodes[i], new):
                parent, best = i, cost
        self.nodes.append(new)
        self.parents.append(parent)
        for _, i in by_cost:
            shorter = best + apart(new, self.nodes[i]) < self.cost(i)
            if shorter and free(self.counter, self.grid, new, self.nodes[i]):
                self.parents[i] = len(self.nodes) - 1
        if new == list(self.goal):
            self.goal_node = len(self.nodes) - 1
