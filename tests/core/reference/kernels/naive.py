"""Slow, plain twins of the compiled kernels: no shared code, no cleverness."""

import math

import numpy as np

F = np.float32


# ---- voxels --------------------------------------------------------------------------------------------------------
def cell_of(grid, point):
    """Voxel (ix, iy, iz) of a point, or None outside of the grid."""
    if not all(abs(value) < 4000.0 for value in point):
        return None
    corner = (grid.x0, grid.y0, grid.z0)
    cell = tuple(math.floor((value - low) * grid.inverse) for value, low in zip(point, corner, strict=True))
    inside = all(0 <= i < n for i, n in zip(cell, (grid.nx, grid.ny, grid.nz), strict=True))
    return cell if inside else None


def flat(grid, cell):
    return (cell[0] * grid.ny + cell[1]) * grid.nz + cell[2]


def intervals(grid, a, b):
    """Stretches of a segment that lie in one voxel each: (share at its start, its length, voxel or None)."""
    corner = np.array([grid.x0, grid.y0, grid.z0])
    start = (np.asarray(a) - corner) * grid.inverse
    end = (np.asarray(b) - corner) * grid.inverse
    shares = {0.0, 1.0}
    for axis in range(3):
        low, high = sorted((start[axis], end[axis]))
        for plane in range(math.ceil(low), math.floor(high) + 1):
            if end[axis] != start[axis]:
                shares.add((plane - start[axis]) / (end[axis] - start[axis]))
    ordered = sorted(share for share in shares if 0.0 <= share <= 1.0)
    if len(ordered) == 1:
        ordered = [0.0, 0.0]
    crossed = []
    for first, last in zip(ordered[:-1], ordered[1:], strict=True):
        middle = start + (end - start) * 0.5 * (first + last)
        cell = tuple(math.floor(value) for value in middle)
        inside = all(0 <= i < n for i, n in zip(cell, (grid.nx, grid.ny, grid.nz), strict=True))
        crossed.append((first, last - first, cell if inside else None))
    if not np.any(end != start):
        crossed = [(0.0, 0.0, cell_of(grid, a))]
    return crossed


def first_blocked(counter, grid, a, b, outside_blocked):
    """Share at which a segment enters a blocked voxel, 2.0 if it never does."""
    for share, _, cell in intervals(grid, a, b):
        if outside_blocked if cell is None else counter[flat(grid, cell)] > 0:
            return share
    return 2.0


# ---- perception ----------------------------------------------------------------------------------------------------
def back_project(ranges, directions, rotation, origin, max_range):
    points = np.empty((len(ranges), 3), F)
    for i, distance in enumerate(ranges.astype(float)):
        if distance > max_range:
            distance = 1.25 * max_range
        with np.errstate(all="ignore"):
            points[i] = origin + rotation @ (directions[i] * distance)
    return points


class OctoMapTwin:
    """OctoMap's rule on a dictionary of voxels, keyed by OctoMap's keys."""

    def __init__(self, frame, rule):
        self.frame, self.rule = frame, rule
        self.log_odds = {}

    def key(self, point):
        return tuple(math.floor(1.0 / self.frame.resolution * float(value)) for value in point)

    def ray(self, origin, end):
        """Keys on a ray without the last one (OctoMap: computeRayKeys)."""
        key, last = list(self.key(origin)), self.key(end)
        if tuple(key) == last:
            return []
        difference = [F(e) - F(o) for e, o in zip(end, origin, strict=True)]
        length = F(np.sqrt(F(difference[0] * difference[0] + difference[1] * difference[1]) + difference[2] ** 2))
        step, t_max, t_delta = [0] * 3, [1.7976931348623157e308] * 3, [1.7976931348623157e308] * 3
        for axis in range(3):
            direction = F(difference[axis] / length)
            step[axis] = int(np.sign(direction))
            if step[axis]:
                border = (key[axis] + 0.5) * self.frame.resolution
                border += float(F(step[axis] * self.frame.resolution * 0.5))
                t_max[axis] = (border - float(origin[axis])) / float(direction)
                t_delta[axis] = self.frame.resolution / abs(float(direction))
        keys = []
        while True:
            keys.append(tuple(key))
            if t_max[0] < t_max[1]:
                axis = 0 if t_max[0] < t_max[2] else 2
            else:
                axis = 1 if t_max[1] < t_max[2] else 2
            key[axis] += step[axis]
            t_max[axis] += t_delta[axis]
            if tuple(key) == last or min(t_max) > float(length):
                return keys

    def insert(self, points, origin, max_range):
        frame = self.frame
        shift = np.array([frame.shift_x, frame.shift_y, frame.shift_z])
        start = (np.asarray(origin, float) + shift).astype(F)
        free, occupied = set(), set()
        for point in points:
            if not all(abs(float(value)) < 4000.0 for value in point):
                continue
            end = (point.astype(float) + shift).astype(F)
            d = [F(end[axis] - start[axis]) for axis in range(3)]
            distance = math.sqrt(float(F(F(F(d[0] * d[0]) + F(d[1] * d[1])) + F(d[2] * d[2]))))
            if distance > max_range:
                end = np.array([start[i] + F(F(d[i] / F(distance)) * F(max_range)) for i in range(3)], F)
            else:
                occupied.add(self.key(end))
            free.update(self.ray(start, end))
        rule = self.rule
        for key in free - occupied:
            self.log_odds[key] = max(F(self.log_odds.get(key, F(0.0)) + rule.miss), rule.clamp_min)
        for key in occupied:
            self.log_odds[key] = min(F(self.log_odds.get(key, F(0.0)) + rule.hit), rule.clamp_max)

    def dense(self):
        frame = self.frame
        grid = np.zeros((frame.nx, frame.ny, frame.nz), F)
        for key, value in self.log_odds.items():
            index = (key[0] - frame.kx, key[1] - frame.ky, key[2] - frame.kz)
            if all(0 <= i < n for i, n in zip(index, grid.shape, strict=True)):
                grid[index] = value
        return grid.ravel()


def recount(grid, occupied, offsets):
    """For each voxel, how many occupied ones have it in their ball."""
    counter = np.zeros((grid.nx, grid.ny, grid.nz), np.int16)
    for cell in np.argwhere(occupied.reshape(counter.shape)):
        targets = cell + np.asarray(offsets)
        inside = ((targets >= 0) & (targets < counter.shape)).all(axis=1)
        np.add.at(counter, tuple(targets[inside].T), 1)
    return counter.ravel()


def time_to_collision(counter, grid, position, points, first, remaining, outside_blocked):
    if not 0 <= first < len(points):
        return -1.0
    legs = [(position, points[first, :3], 0.0)]
    time = remaining
    for i in range(first, len(points) - 1):
        legs.append((points[i, :3], points[i + 1, :3], max(time, 0.0)))
        time += points[i + 1, 10]
    for a, b, when in legs:
        if first_blocked(counter, grid, a, b, outside_blocked) <= 1.0:
            return when
    return -1.0


def known_free_distance(counter, cells, grid, points, first, horizon, reach, escaping):
    arcs = [0.0]
    for a, b in zip(points[:-1, :3], points[1:, :3], strict=True):
        arcs.append(arcs[-1] + math.dist(a, b))
    shape = (grid.nx, grid.ny, grid.nz)
    known_cells = cells.reshape(shape)
    unknown, leading, before = math.inf, escaping, "none"
    for i in range(first, len(points)):
        cell = cell_of(grid, points[i, :3])
        if cell == before:
            continue  # one look at each voxel
        before = cell
        if cell is None:
            return arcs[i], unknown
        if counter[flat(grid, cell)] > 0:
            near = arcs[i] < 1.5 and (known_cells[cell] != 2 or arcs[i] < 0.5)
            if not (leading and near):
                return arcs[i], unknown
            unknown = min(unknown, arcs[first])
            continue
        leading = False
        box = tuple(slice(max(c - r, 0), c + r + 1) for c, r in zip(cell, (reach, reach, 1), strict=True))
        if arcs[i] - arcs[first] < horizon and (known_cells[box] == 0).any():
            unknown = min(unknown, arcs[i])
    return math.inf, unknown


# ---- planning ------------------------------------------------------------------------------------------------------
def length(path):
    return sum(math.dist(a, b) for a, b in zip(path[:-1], path[1:], strict=True))


def nearest_clear(blocked, check, core, grid, point, lower, upper, radius):
    """Distance to the nearest clear place, or None."""
    here = cell_of(grid, point)
    if here is None:
        return None
    if np.all(point >= lower) and np.all(point <= upper) and blocked[flat(grid, here)] == 0:
        return 0.0
    candidates = []
    for cell in np.ndindex(grid.nx, grid.ny, grid.nz):
        centre = np.array([grid.x0, grid.y0, grid.z0]) + (np.array(cell) + 0.5) / grid.inverse
        away = math.dist(point, centre)
        if blocked[flat(grid, cell)] > 0 or away > radius or np.any(centre < lower) or np.any(centre > upper):
            continue
        in_the_way = core if check[flat(grid, here)] > 0 else check
        if first_blocked(in_the_way, grid, point, centre, True) > 1.0:
            candidates.append(away)
    return min(candidates, default=None)


def tight_share(wide, grid, a, b):
    steps = int(math.dist(a, b) / 0.25) + 1
    cells = [cell_of(grid, a + (b - a) * (k + 0.5) / steps) for k in range(steps)]
    return sum(cell is not None and wide[flat(grid, cell)] > 0 for cell in cells) / steps


def angle(a, b, c):
    cosine = np.dot(b - a, c - b) / (np.linalg.norm(b - a) * np.linalg.norm(c - b))
    return math.acos(min(1.0, max(-1.0, cosine)))


def travel_time(wide, grid, path, velocity, pace):
    time = min(np.linalg.norm(velocity), pace.speed) / pace.tangential
    time *= math.sin(0.5 * angle(path[0] - velocity, path[0], path[1])) ** 2
    for a, b in zip(path[:-1], path[1:], strict=True):
        share = tight_share(wide, grid, a, b)
        time += math.dist(a, b) * ((1.0 - share) / pace.speed + share / pace.tight_speed)
        time += max(0.0, abs(b[2] - a[2]) - 0.6 * math.dist(a[:2], b[:2])) / 0.5
    for a, b, c in zip(path[:-2], path[1:-1], path[2:], strict=True):
        turn = min(angle(a, b, c), 3.0)
        if turn >= 1e-3:
            reach = min(pace.blend, 0.5 * math.dist(a, b), 0.5 * math.dist(b, c))
            slow = min(pace.speed, math.sqrt(pace.lateral * reach / (1.2 * math.tan(0.5 * turn))))
            time += (pace.speed - slow) ** 2 / (pace.speed * pace.tangential)
    return time


def hold_points(dense, per_point, step, look):
    last = len(dense) - 1
    points = []
    for a in range(0, last, per_point):
        b = min(a + per_point, last)
        duration = (b - a) * step
        move = dense[min(b + look, last), :3] - dense[min(a + look, last), :3]
        points.append([*dense[b, :3], dense[a, 3], *(move / duration), *dense[a, 7:10], duration])
    points.append([*dense[last, :3], dense[last, 3], *np.zeros(6), per_point * step])
    return np.array(points)


def advance_clock(clock, points, arc, dt, blocked, unknown, braking, creep, fastest):
    position, rate, _ = clock
    here = min(math.floor(position), len(points) - 1)
    speed = math.hypot(*points[here, 4:7])
    limits = [math.inf]
    if unknown < math.inf:
        limits.append(max(creep, math.sqrt(2 * braking * max(0.0, unknown - 0.3 - arc[here]))))
    if blocked < math.inf:
        limits.append(math.sqrt(2 * braking * max(0.0, blocked - 0.3 - arc[here])))
    limit, scale = min(limits), max(speed, 0.3)
    if limit < speed:
        wanted = min(fastest, limit / scale)
    else:
        wanted = fastest if limit > 1e-3 else 0.0
    new = min(rate + braking * dt / scale, max(rate - 2 * braking * dt / scale, wanted))
    new = new if new > 1e-3 else 0.0
    return min(position + new, len(points) - 1.0), new, (new - rate) / dt


# ---- control -------------------------------------------------------------------------------------------------------
def track(waypoint, odometry, memory, gains, dt):
    """Command, slow-down and memory after one step."""
    error = waypoint[:3] - odometry[:3]
    integral = np.clip(memory[:3] + error * dt, -gains.integral_limit, gains.integral_limit)
    rate = (error - memory[3:6]) / dt if memory[6] else np.zeros(3)
    velocity = gains.velocity * waypoint[4:7] + gains.acceleration * waypoint[7:10]
    velocity = velocity + gains.p * error + gains.i * integral + gains.d * rate
    speed = math.hypot(*velocity)
    slowdown = max(1.0, speed / gains.limit)
    w, x, y, z = odometry[6:10]
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    turn = (waypoint[3] - yaw + math.pi) % (2 * math.pi) - math.pi
    yaw_rate = np.clip(3.0 * turn, -gains.yaw_rate, gains.yaw_rate)
    command = np.array([*(velocity / slowdown), yaw_rate])
    return command, min(slowdown, gains.slowdown_cap), np.array([*integral, *error, 1.0])


class Xoshiro:
    """xoshiro256+ on Python integers."""

    def __init__(self, state):
        self.s = [int(word) for word in state]

    def uniform(self):
        mask = (1 << 64) - 1
        s = self.s
        result = (s[0] + s[3]) & mask
        shifted = (s[1] << 17) & mask
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= shifted
        s[3] = ((s[3] << 45) | (s[3] >> 19)) & mask
        return (result >> 11) / 2**53
