"""Powering up: the order of section 5.4.2 and what a wrong one does."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.errors import BadExperiment, UnknownName
from vlab.hardware.interlock import NEEDS, ORDER, PAUSE, PowerUp, power_up, power_up_as_told, time_to_rise
from vlab.lab import Experiment, run_experiment


def switched(hardware, *steps, interlocked=False) -> PowerUp:
    switches = PowerUp(hardware, interlocked=interlocked)
    for step in steps:
        switches.switch_on(step)
    return switches


def test_the_right_order_leads_to_a_quiet_bench(laboratory):
    switches = power_up(laboratory)
    switches.wait(3600.0)
    assert switches.is_ready
    assert switches.faults == []
    assert switches.coil_rise == 0.0
    assert switches.bench() is laboratory


def test_only_the_right_order_has_no_fault(laboratory):
    # every order that can be taken at all, with a few minutes before the last step but one
    good = []
    for order in permutations(ORDER):
        switches = PowerUp(laboratory, interlocked=False)
        try:
            for step in order:
                switches.switch_on(step)
                switches.wait(300.0)
        except BadExperiment:
            continue  # cannot run yet, or held off by the thermostat
        if switches.is_ready and not switches.faults:
            good.append(order)
    # the array's power may come before the computers: without amplifiers its direct signals reach nothing
    assert tuple(ORDER) in good
    assert all(order[-2:] == ("amplifiers", "op-amps") for order in good)


def test_an_order_that_is_told_takes_its_time_and_trips_where_the_text_says(laboratory):
    told = power_up_as_told(laboratory, ", ".join(ORDER))
    assert told.is_ready
    assert told.time == PAUSE * len(ORDER)
    warming = time_to_rise(laboratory.power_up, laboratory.coil.resistance)
    assert warming < PAUSE  # a pause is long enough for the fault to show
    with pytest.raises(BadExperiment, match=f"after {3 * PAUSE + warming:.0f} s the array was on without its program"):
        power_up_as_told(laboratory, "computers,software,array,amplifiers,control,op-amps")


@pytest.mark.parametrize("wrong", ["software", "array", "control", "amplifiers", "op-amps"])
def test_the_interlock_holds_back_what_comes_later(laboratory, wrong):
    with pytest.raises(BadExperiment, match="powering up"):
        PowerUp(laboratory).switch_on(wrong)


def test_the_interlock_names_the_next_step(laboratory):
    switches = switched(laboratory, "computers", "software", "array", interlocked=True)
    with pytest.raises(BadExperiment, match="the interlock allows 'control' next"):
        switches.switch_on("amplifiers")


@pytest.mark.parametrize("step", NEEDS)
def test_what_needs_something_else_cannot_run_alone(laboratory, step):
    with pytest.raises(BadExperiment, match="cannot run before"):
        switched(laboratory, step)


def test_an_array_without_its_program_heats_the_coils_until_they_trip(laboratory):
    switches = switched(laboratory, "computers", "software", "array", "amplifiers")
    facts, coil = laboratory.power_up, laboratory.coil
    assert switches.coil_force == pytest.approx(facts.direct_current * coil.force_constant)
    expected = time_to_rise(facts, coil.resistance)
    switches.wait(0.999 * expected)
    assert not switches.is_tripped
    switches.wait(0.002 * expected)
    assert switches.is_tripped
    assert switches.coil_current == 0.0
    assert "amplifiers" not in switches.on
    assert [(fault.kind, fault.time) for fault in switches.faults] == [("coil-tripped", pytest.approx(expected))]


def test_the_coil_warms_and_cools_as_its_equation(laboratory):
    # C dT/dt = I^2 R - T/R_th by an independent integrator, current for 40 s and none for 60 s
    facts, resistance = laboratory.power_up, laboratory.coil.resistance
    switches = switched(laboratory, "computers", "software", "array", "amplifiers")
    switches.wait(40.0)
    switches.switch_on("control")
    switches.wait(60.0)

    def slope(t, T):
        power = facts.direct_current**2 * resistance if t < 40.0 else 0.0
        return (power - T / facts.thermal_resistance) / facts.heat_capacity

    exact = solve_ivp(slope, (0, 100), [0.0], rtol=1e-9, atol=1e-9, max_step=1.0).y[0, -1]
    assert switches.coil_rise == pytest.approx(exact, rel=1e-4)  # the integrator steps over the switch


def test_many_short_waits_are_one_long_wait(laboratory):
    once, often = (switched(laboratory, "computers", "software", "array", "amplifiers") for _ in range(2))
    once.wait(300.0)
    for _ in range(3000):
        often.wait(0.1)
    assert often.coil_rise == pytest.approx(once.coil_rise, rel=1e-9)
    assert [f.kind for f in often.faults] == [f.kind for f in once.faults] == ["coil-tripped"]


def test_a_small_current_never_trips(laboratory):
    weak = replace(laboratory, power_up=replace(laboratory.power_up, direct_current=0.5))
    switches = switched(weak, "computers", "software", "array", "amplifiers")
    switches.wait(1e5)
    assert not switches.is_tripped
    assert time_to_rise(weak.power_up, weak.coil.resistance) == np.inf
    assert switches.coil_rise == pytest.approx(12.0 * 8.0 * 0.25)  # R_th R I^2


def test_a_tripped_coil_comes_back_when_it_has_cooled(laboratory):
    switches = switched(laboratory, "computers", "software", "array", "amplifiers")
    switches.wait(time_to_rise(laboratory.power_up, laboratory.coil.resistance) + 1.0)
    switches.switch_on("control")
    with pytest.raises(BadExperiment, match="the thermostat lets go"):
        switches.switch_on("amplifiers")
    switches.wait(laboratory.power_up.thermal_resistance * laboratory.power_up.heat_capacity)  # one time constant: 37 %
    switches.switch_on("amplifiers")
    switches.switch_on("op-amps")
    assert switches.is_ready


def test_a_computer_that_starts_with_live_amplifiers_kicks_the_structure(laboratory):
    switches = switched(laboratory, "amplifiers", "computers")
    assert [(f.kind, f.value) for f in switches.faults] == [("starting-impulse", laboratory.power_up.starting_impulse)]


def test_switching_around_live_op_amps_makes_the_sensors_noisy(laboratory, modal):
    switches = switched(laboratory, "computers", "software", "array", "control", "op-amps", "amplifiers")
    assert [f.kind for f in switches.faults] == ["unstable-sensors"]
    assert not switches.is_ready
    run = run_experiment(Experiment(plant=modal, seconds=1.0, hardware=switches.bench())).recording
    assert np.std(run["sensor:base"]) == pytest.approx(laboratory.power_up.unstable_noise, rel=0.1)  # 2000 samples
    switches.switch_off("op-amps")
    switches.switch_on("op-amps")
    assert switches.is_ready
    assert switches.bench() is laboratory


def test_switching_off_runs_backwards(laboratory):
    switches = power_up(laboratory)
    with pytest.raises(BadExperiment, match="the interlock switches 'op-amps' off first"):
        switches.switch_off("amplifiers")
    for step in reversed(ORDER):
        switches.switch_off(step)
    assert switches.on == ()
    assert switches.faults == []


def test_a_bench_that_is_not_on_gives_no_hardware(laboratory):
    with pytest.raises(BadExperiment, match="'amplifiers' is off"):
        switched(laboratory, "computers", "software", "array", "control").bench()


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf")])
def test_waits_that_make_no_sense_are_refused(laboratory, seconds):
    with pytest.raises(BadExperiment, match="makes no sense"):
        PowerUp(laboratory).wait(seconds)


def test_unknown_equipment_and_hardware_without_facts_are_refused(laboratory):
    with pytest.raises(UnknownName, match="did you mean 'amplifiers'"):
        PowerUp(laboratory).switch_on("amplifier")
    with pytest.raises(BadExperiment, match=r"add a table \[power_up\]"):
        PowerUp(replace(laboratory, power_up=None))
    with pytest.raises(BadExperiment, match="on already"):
        switched(laboratory, "computers", "computers")
