"""The messages of the testbed: what a vehicle knows, does and remembers in a tick, and the rest.

SI units and radians. Poses and twists are in the table frame W, wrenches in the body frame B. An
unknown number is NaN, an absent part has its `..._known` or `..._kind` at zero. Vehicles,
obstacles and rows of the fault table are numbered in the order of the experiment's file, which
the message `Names` repeats.
"""

from testbed.core.codes import Hazard, InhibitReason, Response
from testbed.core.records.definition import message, text_message
from testbed.core.records.kinds import Active, EventKind, FaultCode, SetpointKind

POSE = message("Pose", "Position and heading in W.", """
    float64 x  # [m]
    float64 y  # [m]
    float64 theta  # counter-clockwise [rad]
""")  # fmt: skip

TWIST = message("Twist", "Velocity and turn rate in W.", """
    float64 vx  # [m/s]
    float64 vy  # [m/s]
    float64 omega  # [rad/s]
""")  # fmt: skip

ACCEL = message("Accel", "Acceleration and angular acceleration in W.", """
    float64 ax  # [m/s^2]
    float64 ay  # [m/s^2]
    float64 alpha  # [rad/s^2]
""")  # fmt: skip

WRENCH = message("Wrench", "Force and torque in B, about the body's origin.", """
    float64 fx  # [N]
    float64 fy  # [N]
    float64 tau  # [N m]
""")  # fmt: skip

POSE_SAMPLE = message("PoseSample", "One rigid body in one motion-capture frame.", """
    float64 captured_at  # middle of the exposure [s]
    float64 x  # [m]
    float64 y  # [m]
    float64 theta  # [rad]
""")  # fmt: skip

STATE = message("State", "A vehicle's estimate of its own state at time t.", """
    float64 t  # [s]
    Pose pose
    Twist twist
    Accel bias  # acceleration that the commanded jets do not explain
    float64 pose_age  # since the newest accepted sample was captured [s]
    uint32 rejected  # samples that the outlier gate refused recently
    uint32 reserved
""")  # fmt: skip

REFERENCE = message("Reference", "Desired motion at t, acceleration in the jet period after.", """
    float64 t  # [s]
    Pose pose
    Twist twist
    Accel accel
""")  # fmt: skip

DEMAND = message("Demand", "A mean force for the jet period after t, and a heading to hold.", """
    float64 t  # [s]
    float64 fx_w  # force in W [N]
    float64 fy_w  # [N]
    float64 theta  # [rad]
    float64 omega  # [rad/s]
    float64 alpha  # [rad/s^2]
    float64 valid_until  # not used afterwards [s]
""")  # fmt: skip

AIM = message("Aim", "A setpoint without its references.", """
    Demand demand  # if kind is DEMAND
    float64 valid_until  # if kind is TRAJECTORY: not used afterwards [s]
    uint32 kind
    uint32 reserved
""", kind=SetpointKind)  # fmt: skip

PULSE = message("Pulse", "The pulse of one valve in a jet period.", """
    uint32 on_us  # open time [us]
    uint32 offset_us  # from the plan's start to the opening command [us]
""")  # fmt: skip

NEIGHBOUR = message("Neighbour", "The newest state of another vehicle, of any age.", """
    State state
    uint32 vehicle  # its number
    uint32 reserved
""")  # fmt: skip

HEARD = message("Heard", "The newest message of another vehicle's law.", """
    float64 t  # time for which it is valid [s]
    uint32 vehicle  # its number
    uint32 length  # number of its values
""")  # fmt: skip

HEALTH = message("Health", "The valve board's report.", """
    float64 t  # board's time [s]
    float64 supply_pressure  # behind the regulator [Pa]
    float64 tank_pressure  # [Pa]
    float64 battery  # [V]
    float64 silent_s  # since the board last answered [s]
""")  # fmt: skip

VITALS = message("Vitals", "Data about a vehicle's process, the network and the operator.", """
    float64 operator_age  # since the operator's presence was last heard [s]
    float64 clock_offset  # the host's clock minus the vehicle's [s]
    float64 late_s  # delay of this tick's start [s]
    float64 disk_free  # on the disk of the log [bytes]
    uint32 foreign  # messages of another session since the last tick; none was obeyed
    uint8 session_ok  # setpoints are of the session that armed the vehicle
    uint8 same_config  # host and vehicle have the same configuration hash
    uint8 law_error  # 1: the law on the host raised an exception; its text is an event
    uint8 fleet  # 1: a fault of another vehicle stops all; its text is an event
""")  # fmt: skip

INTERVENTION = message("Intervention", "Change of the demanded force by the safety filter.", """
    float64 dfx_w  # change of the mean force in W [N]
    float64 dfy_w  # [N]
    uint32 subject  # number of the obstacle or vehicle that it avoids plus one; 0: neither
    uint16 hazard  # what it avoids; 0: the demand was not changed
    uint16 reserved
""", hazard=Hazard)  # fmt: skip

TICK_INPUTS = message("TickInputs", "Inputs of a tick, without its sequences.", """
    float64 t  # [s]
    Aim setpoint  # the newest one, of any age; `references` has those of a trajectory
    Health health
    Vitals vitals
    uint8 armed  # valves may open
    uint8 end  # 1: the flight is over: come to rest and turn the air off
    uint8[6] reserved
""")  # fmt: skip

TICK_OUTPUTS = message("TickOutputs", "Outputs of a tick, without its sequences.", """
    float64 t  # [s]
    State state  # if state_known
    Reference reference  # input of the tracker, if active is REFERENCE
    Demand demand  # the same, if active is DEMAND
    Wrench commanded_wrench  # demanded by tracker or law, mean over the period
    Wrench realised_wrench  # mean wrench of the jets, with droop and as bad jets give it
    Intervention filtered
    float64 issued_at  # of the plan [s]
    float64 valid_until  # every valve is closed afterwards [s]
    float64 message_t  # time for which the message of its law is valid [s]
    float64[3] inhibit_values  # in the order of the words of `inhibit`
    float64 fault_value  # number of the detector of `fault`
    uint64 faults  # rows of the fault table that hold now: row k is bit k
    uint32 seq  # of the plan
    uint16 fault  # ends the run, latched; k + 1: row k of the fault table
    uint8 inhibit  # why valves stay shut; 0: they may open
    uint8 inhibit_length  # number of its values
    uint8 response  # the most severe active one
    uint8 state_known  # 0: before the first pose
    uint8 active  # input of the tracker
    uint8 air_off  # turn the bearing air off for good
    uint8 message_known  # its law on board sends a message
    uint8[3] reserved
""", active=Active, fault=FaultCode, inhibit=InhibitReason, response=Response)  # fmt: skip

TICK = message("Tick", "One vehicle's complete tick: inputs and outputs of its flight chain.", """
    TickInputs inputs
    TickOutputs outputs
    uint32 samples_valid  # poses that arrived since the last tick, in order of arrival
    PoseSample[] samples
    uint32 neighbours_valid  # in the order in which they were first heard
    Neighbour[] neighbours
    uint32 references_valid  # of the setpoint, in order of time
    Reference[] references
    uint32 pulses_valid  # of the plan: one per valve
    Pulse[] pulses
    uint32 heard_valid  # messages of the other vehicles' laws
    Heard[] heard
    uint32 heard_values_valid  # of all these messages, one after the other
    float64[] heard_values
    uint32 message_valid  # values of its own law's message
    float64[] message
""")  # fmt: skip

HOST_INPUTS = message("HostInputs", "Inputs of a law on the host, without its sequences.", """
    float64 t  # [s]
    State own  # newest state of the vehicle, of any age, if own_known
    uint8 own_known  # 0: the vehicle has sent none
    uint8[7] reserved
""")  # fmt: skip

HOST_OUTPUTS = message("HostOutputs", "Outputs of a law on the host, without its sequences.", """
    float64 t  # [s]
    Aim setpoint  # `references` has those of a trajectory
    Intervention filtered  # change of the reference model's force
    float64 message_t  # time for which the message of the law is valid [s]
    uint8 fault  # 1: a fault of the law; its text is an event
    uint8 message_known  # the law sends a message
    uint8[6] reserved
""")  # fmt: skip

HOST_TICK = message("HostTick", "A complete tick of a law on the host.", """
    HostInputs inputs
    HostOutputs outputs
    uint32 neighbours_valid  # in the order in which they were first heard
    Neighbour[] neighbours
    uint32 references_valid  # of the setpoint, in order of time
    Reference[] references
    uint32 heard_valid  # messages of the other vehicles' laws
    Heard[] heard
    uint32 heard_values_valid  # of all these messages, one after the other
    float64[] heard_values
    uint32 message_valid  # values of the law's own message
    float64[] message
""")  # fmt: skip

ENVELOPE = message("Envelope", "Before every message on the testbed's own network keys.", """
    uint64 session  # number of the run
    uint64 seq  # rises by one per message of a sender and key
    float64 issued_at  # by the host's clock, from the run's time 0 [s]
    float64 valid_until  # not used afterwards [s]
    uint32 schema  # version of the messages; others are refused
    uint32 reserved
""")  # fmt: skip

SETPOINT = message("Setpoint", "What a vehicle shall do: on the network.", """
    Aim aim
    uint32 references_valid  # in order of time
    Reference[] references
""")  # fmt: skip

LAW_MESSAGE = message("LawMessage", "Message of a vehicle's law to the others: on the network.", """
    float64 t  # time for which it is valid [s]
    uint32 values_valid  # by the law's own convention, in the law's own units
    float64[] values
""")  # fmt: skip

MOTION = message("Motion", "True pose and twist of a vehicle; only from a twin.", """
    Pose pose
    Twist twist
""")  # fmt: skip

TRUTH = message("Truth", "True motion of all vehicles at a tick.", """
    float64 t  # [s]
    uint32 vehicles_valid  # in the order of the experiment
    Motion[] vehicles
""")  # fmt: skip

CONTACT = message("Contact", "A touch of a vehicle and another body.", """
    float64 t  # [s]
    float64 speed  # closing [m/s]
    uint32 vehicle  # its number
    uint32 other  # number of the vehicle or obstacle; see hazard
    uint16 hazard  # what was touched
    uint16[3] reserved
""", hazard=Hazard)  # fmt: skip

VALVES = message("Valves", "Outputs of a valve board from t on.", """
    float64 t  # [s]
    uint64 mask  # bit 0 is jet 1; 1 is open
""")  # fmt: skip

LOOP = message("Loop", "Timing of a flight's loop in real time.", """
    float64 t  # the tick was due [s]
    float64 late_s  # delay of its start [s]
    float64 busy_s  # its duration [s]
""")  # fmt: skip

PACE = message("Pace", "Timing of a vehicle's tick, and state of its connections.", """
    float64 t  # [s]
    float64 late_s  # delay of the tick's start [s]
    float64 pose_to_valve_s  # newest plan: from the arrival of its newest pose to its frame [s]
    float64 setpoint_delay_s  # newest setpoint, from issue to arrival [s]
    float64 round_trip_s  # of the newest query to the host [s]
    uint32 setpoints_heard  # so far
    uint32 setpoints_lost  # so far, from gaps in their numbers
    uint32 refused  # messages that were late, expired, foreign etc., so far
    uint32 frames_lost  # camera frames, so far
    uint32 cameras  # 1: a fault of its rigid body; its text is an event
    uint32 reserved
""")  # fmt: skip

FORMATION = message("Formation", "The five elements of a formation.", """
    float64 t  # [s]
    float64[2] p  # mean position [m]
    float64[2] v  # mean velocity [m/s]
    float64 outer  # largest distance from the mean position [m]
    float64 inner  # smallest gap between two vehicles [m]
    float64 uniformity  # [-]
    uint32 count  # of vehicles
    uint32 reserved
""")  # fmt: skip

text_message("Event", "Something with a text; a row with its code means the newest one.", """
    float64 t  # [s]
    uint8 kind  # what it is about
    string id  # of a fault or phase
    string text  # for a person
    string parts  # all that is known of a fault, as JSON
""", kind=EventKind)  # fmt: skip

text_message("Names", "Names that other messages refer to by number.", """
    float64 t  # [s]
    string[] vehicles
    string[] obstacles
    string[] faults  # rows of the fault table
""")  # fmt: skip
