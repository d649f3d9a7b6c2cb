"""Groups of the same sites have the same draws, each with its lifetime."""

import numpy as np
import pytest

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.flight.host import Flight
from mavfi.levels.level import Sampled
from mavfi.levels.state import StateLevel, fewer_fields
from mavfi.levels.state.sampling import StateSampler
from mavfi.record import Profile
from mavfi.states import PUBLISHED_SITES
from mavfi.states import STATES as SPECS

SITES = ["planning.waypoint.x", "perception.collision_status.collision"]
STATES = ("planning.waypoint", "perception.collision_status")
PROFILE = Profile({name: np.arange(50) for name in STATES}, {name: np.zeros(50, np.int32) for name in STATES})


def faults(*lifetimes, **campaign):
    groups = [
        {"name": str(site_of), "sites": SITES, **({} if lifetime is None else {"lifetime": lifetime})}
        for site_of, lifetime in enumerate(lifetimes)
    ]
    sampling = {"scheme": "groups", "groups": groups, "strata": {"sign_exponent": 1}, **campaign}
    sampler = StateSampler(
        Campaign(name="c", environments=("sparse",), missions=1, faults=40, sampling={"level": "state", **sampling})
    )
    drawn_faults = []
    for block in sampler.blocks("sparse"):
        draws = [block.draw(index) for index in range(block.count)]
        drawn_faults.append(sampler.draw(draws, "sparse", {"": Sampled(Flight(None, PROFILE))}))
    return drawn_faults


def site_of(fault):
    return fault.where, fault.time_us, fault.stratum, fault.seed


def test_the_same_draws_with_each_lifetime():
    once, stuck, other = faults({}, {"lasts_s": "inf", "share": 0.5}, None)
    assert (
        [site_of(fault) for fault in once] == [site_of(fault) for fault in stuck] != [site_of(fault) for fault in other]
    )
    assert {(fault.lasts_s, fault.share) for fault in stuck} == {(float("inf"), 0.5)}
    assert not any(fault.lasting for fault in once + other)


def test_bursts_lie_within_their_word():
    (wide,) = faults(None, lifetime={"width": 8})
    assert {(fault.where.field, fault.width) for fault in wide} == {("x", 8), ("collision", 1)}
    assert max(fault.bit for fault in wide if fault.where.field == "x") == 56


def messages(names, host="local", **sampling):
    campaign = {"environments": ("sparse",), "missions": 2, "faults": 30, "host": host}
    return Campaign(name="c", **campaign, sampling={"scheme": "messages", "messages": names, **sampling})


def test_every_message_has_its_own_row_and_the_strata_that_it_has():
    names = ("planning.waypoint", "planning.path")
    sampler = StateSampler(messages(names, strata={"sign_exponent": 1, "length": 1}))
    profile = Profile({name: np.arange(50) for name in names}, {name: np.full(50, 4, np.int32) for name in names})
    for name, block in zip(names, sampler.blocks("sparse"), strict=True):
        drawn_faults = sampler.draw([block.draw(i) for i in range(30)], "sparse", {"": Sampled(Flight(None, profile))})
        strata = [fault.stratum for fault in drawn_faults]
        assert {fault.where.state for fault in drawn_faults} == {name}
        assert strata.count("length") == (15 if name == "planning.path" else 0)
        assert len(set(map(site_of, drawn_faults))) > 25


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": ()}, "is required with scheme 'messages'"),
        ({"names": ("sensor.imu",)}, "sensor.imu: only flights with localization estimator"),
        ({"names": ("planning.waypoint",), "strata": {"length": 1}}, "no field has bits of the stratum 'length'"),
        (
            {"names": ("planning.path",), "strata": {"length": 1}, "host": "ros2"},
            "'length': may lose a message; allowed on ROS: bits of numbers",
        ),
    ],
)
def test_messages_that_cannot_be_drawn_are_refused(arguments, message):
    with pytest.raises((BadInputError, ValueError), match=message):
        messages(**arguments)


def test_the_published_instants_are_those_of_the_pipeline_and_stored_only_if_set():
    assert not {"when", "together"} & set(messages(("planning.waypoint",)).sampling.to_json())
    assert messages(("planning.waypoint",), when="published").sampling.to_json()["when"] == "published"
    with pytest.raises(ValueError, match=r"sampling.when: 'published': sensor.depth: .*allowed: states of perception"):
        messages(("sensor.depth",), when="published")


def test_vectors_are_hit_together_without_a_lifetime_and_made_smaller_by_fields_first():
    (drawn,) = faults(None, together=True)
    assert {tuple(name for name, _ in fault.also) for fault in drawn} == {("y", "z"), ()}
    vector = next(fault for fault in drawn if fault.also)
    assert next(iter(StateLevel.reductions)) == "fields"
    fewer = [(fault.where.field, fault.bit, fault.also) for fault in fewer_fields(vector, None)]
    x, y, z = ("x", vector.bit), *vector.also
    assert fewer == [(*x, ()), (*y, ()), (*z, ()), (*x, (y,)), (*x, (z,)), (*y, (z,))]
    alone = next(fault for fault in drawn if not fault.also)
    assert list(fewer_fields(alone, None)) == []
    for lifetimes in ([{"width": 2}], [None]):
        with pytest.raises(ValueError, match="sampling.together: true: allowed with scheme .* and without a lifetime"):
            faults(*lifetimes, together=True, lifetime={"times": 2})
    with pytest.raises(ValueError, match="sampling.together: true: allowed with scheme stage_balanced or groups"):
        messages(("planning.waypoint",), together=True)


def test_the_published_sites_are_three_states_of_the_table():
    sampling = {"level": "state", "sites": "published", "together": True}
    sampler = StateSampler(Campaign(name="c", environments=("sparse",), missions=9, faults=90, sampling=sampling))
    fields = {"perception": set(), "planning": set(), "control": set()}
    for block in sampler.blocks("sparse"):
        for draw in map(block.draw, range(block.count)):
            (fault,) = sampler.draw([draw], "sparse", {})
            fields[draw.target].add((fault.where.state, fault.where.field))
    drawn = {site for sites in fields.values() for site in sites}
    assert drawn == {(state, name) for state, names in PUBLISHED_SITES.items() for name in names}
    assert all(SPECS[state].find(name) for state, name in drawn)
    assert [{state for state, _ in sites} for sites in fields.values()] == [{state} for state in PUBLISHED_SITES]
    with pytest.raises(ValueError, match="sampling.sites: 'published': allowed with scheme stage_balanced"):
        messages(("planning.waypoint",), sites="published")


# ---- operations ------------------------------------------------------------------------------------------------------
OPERATIONS = ["flip", "set=nan", "bias=0.5:times=3", "freeze"]


def test_operations_are_drawn_at_the_sites_of_flips_each_with_the_same_probability():
    sites = ["control.command.vx", "planning.waypoint.index"]
    groups = [{"name": "all", "sites": sites}]
    drawn = {}
    for operations in ((), OPERATIONS):
        sampling = {"scheme": "groups", "groups": groups, "operations": operations}
        campaign = Campaign(name="c", environments=("sparse",), missions=400, faults=400, sampling=sampling)
        sampler = StateSampler(campaign)
        profile = Profile({"control.command": np.arange(50)}, {"control.command": np.zeros(50, np.int32)})
        (block,) = sampler.blocks("sparse")
        draws = [block.draw(index) for index in range(block.count)]
        drawn[operations == OPERATIONS] = sampler.draw(draws, "sparse", {"": Sampled(Flight(None, profile))})
    names = [StateLevel().columns(fault)["operation"] for fault in drawn[True]]
    assert set(names) == set(OPERATIONS) and min(names.count(name) for name in set(names)) > 60
    for fault, name in zip(drawn[True], names, strict=True):
        assert fault.where.field == "vx"  # a counter cannot be NaN
        assert (fault.bit is None, fault.change is None) == ((False, True) if name == "flip" else (True, False))
    flips = {(fault.where.field, fault.time_us) for fault in drawn[False]}
    assert len({fault.time_us for fault in drawn[True]}) > 40 and {field for field, _ in flips} == {"vx", "index"}
    assert {StateLevel().columns(fault)["operation"] for fault in drawn[False]} == {"flip"}


def test_operations_do_not_change_where_and_when_floats_are_hit():
    sampling = {"scheme": "groups", "groups": [{"name": "g", "sites": ["planning.waypoint.x"]}]}
    places = []
    for operations in ((), ("set=1",), ("freeze:times=9", "scale=2")):
        campaign = Campaign(
            name="c", environments=("sparse",), missions=9, faults=40, sampling={**sampling, "operations": operations}
        )
        sampler = StateSampler(campaign)
        draws = [sampler.blocks("sparse")[0].draw(index) for index in range(40)]
        drawn_faults = sampler.draw(draws, "sparse", {"": Sampled(Flight(None, PROFILE))})
        places.append([(fault.where, fault.time_us, fault.seed) for fault in drawn_faults])
    assert places[0] == places[1] == places[2]
    assert "operations" not in Campaign(name="c", environments=("sparse",), sampling=sampling).sampling.to_json()


@pytest.mark.parametrize(
    ("sampling", "message"),
    [
        ({"operations": ["drop"]}, "'drop': changes no drawn value; allowed: flip, set, bias"),
        ({"operations": ["flip"], "together": True}, "allowed with scheme stage_balanced or groups, without together"),
        (
            {"operations": ["set=nan"], "scheme": "groups", "groups": [{"name": "g", "sites": [SITES[1]]}]},
            "sampling.operations: g: has no field that allows all of them",
        ),
    ],
)
def test_operations_that_cannot_be_drawn_are_refused(sampling, message):
    with pytest.raises(ValueError, match=message):
        Campaign(name="c", environments=("sparse",), sampling={"level": "state", **sampling})
