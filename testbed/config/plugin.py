"""Checks a lab's plug-ins: unknown names and wrong options."""

from collections.abc import Collection, Iterator

import msgspec

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment
from testbed.config.validation import first_violation
from testbed.core import plugin
from testbed.core.lab import MOCAP_SYSTEMS, THRUSTER_SYSTEMS, MocapWire, ThrusterWire


def bad_plugins(experiment: Experiment) -> Iterator[Violation]:
    """Errors in the plug-ins of `[lab.mocap]` and `[lab.thrusters]`."""
    lab = experiment.table.lab
    yield from _plugin("mocap", lab.mocap, plugin.MOCAP, MOCAP_SYSTEMS)
    yield from _plugin("thrusters", lab.thrusters, plugin.THRUSTERS, THRUSTER_SYSTEMS)


def _plugin(
    name: str, wire: MocapWire | ThrusterWire, group: str, built_in: Collection[str]
) -> Iterator[Violation]:
    key = ("table", "lab", name)
    if wire.system in built_in:
        if wire.options:
            expected = f"no options: {wire.system} is built in"
            yield Violation((*key, "options"), expected, show(wire.options))
        return
    try:
        options = plugin.option_type(
            plugin.load(group, wire.system, built_in), plugin.PROVIDED[group]
        )
    except plugin.PluginError as error:
        yield Violation((*key, "system"), error.expected, error.found)
        return
    try:
        msgspec.convert(wire.options, options)
    except msgspec.ValidationError:
        at, expected, found, _ = first_violation(wire.options, options)
        yield Violation((*key, "options", *at), expected, found)
