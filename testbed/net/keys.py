"""Every key on the network, written once.

    <lab>/<vehicle>/state      estimated state, each tick               vehicle -> host, vehicles
    <lab>/<vehicle>/setpoint   what to fly, each tick                   host -> vehicle
    <lab>/<vehicle>/message    what its law says to the others' laws    vehicle -> vehicles
    <lab>/<vehicle>/tick       inputs and outputs, for the log          vehicle -> host
    <lab>/<vehicle>/event      how its flight ended, and why            vehicle -> host
    <lab>/<vehicle>/order      get: start or stop a flight              host -> vehicle
    <lab>/<vehicle>/roll       get: give the host the ticket for an order to start
    <lab>/<vehicle>/alive      liveliness token
    <lab>/table/truth          where everybody really is; only a twin knows
    <lab>/table/pose           poses, where the cameras speak Zenoh
    <lab>/host/permit          may go on flying; lapses                 host -> vehicles
    <lab>/host/clock           get: the host's clock
    <lab>/host/experiment      get: what is flown
    <lab>/host/alive           liveliness token
    <lab>/operator/stop        put or get: end the flight, now          anybody -> all

States and setpoints are latest-wins and may be lost. Orders are answered. Stop is both. In a lab
with keys `access.py` says who may do what here.
"""


class Keys:
    """The keys of one lab."""

    def __init__(self, lab: str) -> None:
        self._lab = lab
        self.truth = f"{lab}/table/truth"
        self.pose = f"{lab}/table/pose"
        self.permit = f"{lab}/host/permit"
        self.clock = f"{lab}/host/clock"
        self.experiment = f"{lab}/host/experiment"
        self.host_alive = f"{lab}/host/alive"
        self.stop = f"{lab}/operator/stop"
        self.everything = f"{lab}/**"

    def of(self, vehicle: str, what: str) -> str:
        """A vehicle's key: state, setpoint, message, tick, event, order, roll or alive."""
        return f"{self._lab}/{vehicle}/{what}"
