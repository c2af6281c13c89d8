"""All keys (topics) on the network.

    <lab>/<vehicle>/state      estimated state, each tick               vehicle -> host, vehicles
    <lab>/<vehicle>/setpoint   what to fly, each tick                   host -> vehicle
    <lab>/<vehicle>/message    message of its law to the other laws     vehicle -> vehicles
    <lab>/<vehicle>/tick       inputs and outputs, for the log          vehicle -> host
    <lab>/<vehicle>/event      how its flight ended, and why            vehicle -> host
    <lab>/<vehicle>/order      get: look, start, retune or stop         host -> vehicle
    <lab>/<vehicle>/roll       get: give the host the ticket for an order to start
    <lab>/<vehicle>/alive      liveliness token
    <lab>/table/truth          true poses of all vehicles; only from a twin
    <lab>/table/pose           poses, where the cameras speak Zenoh
    <lab>/host/lease           permission to fly; expires              host -> vehicles
    <lab>/host/clock           get: the host's clock
    <lab>/host/experiment      get: the experiment
    <lab>/host/ended           get: vehicles that have ended their flight, and their bearing air
    <lab>/host/alive           liveliness token
    <lab>/operator/stop        put or get: end the flight, now          operator -> all

States and setpoints may be lost; only the newest counts. Orders are queries and are answered. Stop
is sent both ways. In a lab with keys `access.py` defines which party may use which key.
"""


class Keys:
    """Network keys of one lab."""

    def __init__(self, lab: str) -> None:
        self._lab = lab
        self.truth = f"{lab}/table/truth"
        self.pose = f"{lab}/table/pose"
        self.lease = f"{lab}/host/lease"
        self.clock = f"{lab}/host/clock"
        self.experiment = f"{lab}/host/experiment"
        self.ended = f"{lab}/host/ended"
        self.host_alive = f"{lab}/host/alive"
        self.stop = f"{lab}/operator/stop"
        self.everything = f"{lab}/**"

    def of(self, vehicle: str, what: str) -> str:
        """A vehicle's key: state, setpoint, message, tick, event, order, roll or alive."""
        return f"{self._lab}/{vehicle}/{what}"
