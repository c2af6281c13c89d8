"""From an assembled vehicle to its first float: steps that measure, and a verdict for each.

The measurements become verdicts in pure functions (`cameras`, `floating`, `jets`). `procedure` asks
a `Station` to move air, valves and vehicles, and keeps every vehicle slow.
"""
