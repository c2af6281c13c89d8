"""Verbs of the networked processes: `twin` and `agent`."""

from collections.abc import Sequence
from pathlib import Path

from testbed.cli.exit_code import FAULT, INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.config import ConfigError, find, load
from testbed.net.credentials import CredentialsError
from testbed.realtime.processes import end_on_terminate
from testbed.rig.wired import agent_process, twin_process
from testbed.rig.wired.agent_process import AgentOptions
from testbed.rig.wired.local import local


def serve_twin(name: str, overrides: Sequence[str], ports: Path | None, *, here: bool) -> int:
    """Run the twin until it is terminated; returns the exit code."""
    end_on_terminate()
    try:
        experiment = load(find(name), overrides)
        if here:
            experiment = local(experiment)
    except ConfigError as error:
        return refuse(error)
    try:
        twin_process.serve(experiment, ports, None, over=lambda: False, notify=errors.print)
    except twin_process.FAILURES as error:
        return refuse(error, FAULT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK


def fly_agent(agent: AgentOptions) -> int:
    """Run the agent of one vehicle; returns the exit code."""
    end_on_terminate()

    def notify(text: str) -> None:
        errors.print(f"{agent.name}: {text}", markup=False, soft_wrap=True)

    try:
        agent_process.fly(agent, notify, child=False)
    except CredentialsError as error:
        return refuse(error)
    except agent_process.FAILURES as error:
        return refuse(error, FAULT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK
