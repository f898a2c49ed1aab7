"""Messages of wire version 11 are these bytes, in both directions. Vehicles of one fleet may run different releases."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest
from msgspec.structs import replace

from companion.types.autopilot import LandedState, PositionError
from companion.types.commands import Command, CommandName, CommandReply, Lead, ReferenceChange
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.peers import (
    BodyPose,
    LeaderReport,
    LostVehicle,
    Motion,
    PeerPacket,
    Sender,
    TargetSample,
    TermProof,
    TrafficSample,
)
from companion.types.status import (
    AgentIdentity,
    AutopilotReport,
    CommandReport,
    ControlReport,
    FormationReport,
    LeadershipReport,
    MotionReport,
    NearestVehicle,
    NeighbourReport,
    NetworkState,
    RecordingState,
    SafetyReport,
    SeparationReport,
    Status,
)
from companion.wire.messages import (
    Percentiles,
    StatusReport,
    Timing,
    WireError,
    decode_command,
    decode_peer,
    decode_pose,
    decode_reply,
    decode_report,
    decode_target,
    decode_traffic,
    encode,
    encode_peer,
)

CHANGE = FormationChange(9, ((2, (-2.0, 1.0, 0.5)), (3, (-4.0, -1.0, 0.25))), 61.5, 7.5, absent=(5,))

# Every value of the messages is another one, so that no two fields can change places.
PACKETS = {
    "least": PeerPacket(
        sender=Sender(vehicle_id=2, session=3, sequence=4, formation_hash=5),
        phase=FlightPhase.HOLD,
        role=Role.LEADER,
        motion=Motion(
            position_enu_m=(1.5, 2.5, 3.5),
            velocity_enu_m_s=(4.5, 5.5, 6.5),
            acceleration_enu_m_s2=(7.5, 8.5, 9.5),
            state_age_s=0.0625,
            sent_s=1234.5,
        ),
        leader=LeaderReport(prc=7, beacon=None),
        slot=FlownSlot((10.5, 11.5, 12.5)),
    ),
    "whole": PeerPacket(
        sender=Sender(vehicle_id=3, session=2**32 - 1, sequence=10**6, formation_hash=2**64 - 1),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(1.25, 2.25, 3.25),
            velocity_enu_m_s=(0.1, 0.2, 0.3),
            acceleration_enu_m_s2=(0.01, 0.02, 0.03),
            state_age_s=0.021,
            sent_s=4321.0625,
        ),
        leader=LeaderReport(
            prc=4,
            beacon=LeaderBeacon(1, 7, 60, 12.5, 8, Heading(1.5, 0.75, 0.375)),
            proof=TermProof(2**31 + 1, bytes(range(100, 164))),
        ),
        slot=FlownSlot((-3.0, 0.5, 0.25), (-0.5, 0.125, 0.0625), (-0.75, 0.15, 0.35), 2, 6, 5.5),
        position_error=PositionError(0.29, 0.28),
        reference=HeldReference(11, 12, 3.5),
        change=CHANGE,
        armed=False,
        rft=((20.5, 21.5, 22.5), (23.5, 24.5, 25.5), (26.5, 27.5, 28.5)),
        home_enu_m=(29.5, 30.5),
        lost=(LostVehicle(7, (31.5, 32.5, 33.5), (0.4, 0.5, 0.6), 34.5),),
        law_values=((35.5, 36.5, 37.5), (38.5, 39.5, 40.5)),
    ),
    "relays a beacon to the east": PeerPacket(
        sender=Sender(vehicle_id=250, session=0, sequence=0, formation_hash=0),
        phase=FlightPhase.OBSERVE,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(0.0, -0.0, 1e-4),
            velocity_enu_m_s=(-1.0, 0.001, 0.0),
            acceleration_enu_m_s2=(0.0, 0.0, -9.81),
            state_age_s=0.0,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=249, beacon=LeaderBeacon(9, 0, 2**40)),
        slot=FlownSlot((0.0, 0.0, 0.0), waiting=3),
        reference=HeldReference(),
    ),
}

CIRCLE = {"kind": "circle", "centre_enu_m": [0.0, 1.0, 2.0], "radius_m": 4, "period_s": 20.5, "points": [[1.0, 2.0]]}
TIMING = Timing(50.0, 3000, 2, Percentiles(1.0, 2.0, 3.0), Percentiles(4.0, 5.0, 6.0), 5.125, 49.0)
REPORTS = {
    "least": StatusReport(
        Status(
            agent=AgentIdentity(vehicle_id=3, session=1, fleet="platoon", formation_hash=5, law="weighted"),
            phase=FlightPhase.HOLD,
            autopilot=AutopilotReport(mode_name="AUTO.LOITER", armed=True, landed=LandedState.IN_AIR),
            motion=MotionReport(position_enu_m=(1.0, 2.0, 3.0), velocity_enu_m_s=(4.0, 5.0, 6.0), state_age_s=0.02),
            control=ControlReport(hover_thrust_norm=0.49, disturbance_enu_m_s2=(1.0, -2.0, 0.0)),
            leadership=LeadershipReport(
                role=Role.FOLLOWER, epoch=7, prc=2, leader_beacon=None, leader_beacon_age_s=None
            ),
            neighbourhood=NeighbourReport(neighbours=()),
            formation=FormationReport(slot=FlownSlot((-3.0, 0.0, 0.0)), reference_enu_m=None),
            safety=SafetyReport(flags=()),
            rejected={},
            last_event=None,
        ),
        TIMING,
    ),
    "whole": StatusReport(
        Status(
            agent=AgentIdentity(vehicle_id=4, session=2**31, fleet="swarm-2", formation_hash=2**63, law="wind"),
            phase=FlightPhase.FORMATION,
            autopilot=AutopilotReport(mode_name="GUIDED", armed=True, landed=LandedState.TAKEOFF, battery_percent=81.0),
            motion=MotionReport(
                position_enu_m=(1.5, 2.5, 3.5),
                velocity_enu_m_s=(4.5, 5.5, 6.5),
                state_age_s=0.04,
                position_error=PositionError(0.31, 0.37),
            ),
            control=ControlReport(
                hover_thrust_norm=0.53, disturbance_enu_m_s2=(0.25, -0.5, 0.0), largest_step_deg=1.75
            ),
            leadership=LeadershipReport(
                role=Role.LEADER,
                epoch=9,
                prc=5,
                leader_beacon=LeaderBeacon(6, 8, 70, 13.5, 1, Heading(0.5, 0.25, 0.125)),
                leader_beacon_age_s=0.06,
            ),
            neighbourhood=NeighbourReport(
                neighbours=(2, 8), peers=(2, 8, 9), weights=(0.375, 0.625), neighbour_ages_s=(0.03, 0.05)
            ),
            formation=FormationReport(
                slot=FlownSlot((-3.5, 0.75, 1.25), (0.15, 0.35, 0.45), (0.55, 0.65, 0.85), 10, 11, 12.5),
                reference_enu_m=(14.5, 15.5, 16.5),
                reference_s=17.5,
                reference=HeldReference(13, 14, 18.5),
                target_age_s=0.08,
                heading=Heading(0.625, 0.3125, 0.1875),
                described=CIRCLE,
            ),
            safety=SafetyReport(
                flags=(HealthFlag.OUTSIDE_FENCE, HealthFlag.BATTERY_LOW),
                refuses_return=Notice(Code.RC_OVERRIDE_OFF, "one"),
                lacks=(Notice(Code.FENCE_ACTION_UNSAFE, "two"),),
                separation=SeparationReport(NearestVehicle("8", 2.75, 2.5), 0.875, True, ("8",)),
                warnings=(Notice(Code.GROUND_LOSS_ACTION, "three"),),
            ),
            rejected={"malformed": 3, "replay": 4},
            last_event=Notice(Code.PHASE_CHANGED, "engage -> formation"),
            command=CommandReport(holder="anna@ground", command_number=15),
            network=NetworkState("identity", 16),
            recording=RecordingState("dropping", 17),
        ),
        TIMING,
    ),
}
OPERATOR = "anna@ground"
COMMANDS = {
    "form": Command(CommandName.FORM, 5, OPERATOR, 6),
    "lead": Command(CommandName.LEAD, 7, OPERATOR, 8, Lead((2, 4), 9)),
    "formation": Command(CommandName.FORMATION, 10, OPERATOR, 11, CHANGE),
    "reference": Command(CommandName.REFERENCE, 12, OPERATOR, 13, ReferenceChange(3, CIRCLE, 21.5)),
}
REPLY = CommandReply(3, 9, True, Code.PHASE_CHANGED, "engage", OPERATOR)
TARGETS = {
    "joystick": TargetSample(1, 2, 3.5, (1.0, 0.5, 0.25)),
    "target": TargetSample(2**32 - 1, 7, 12.5, (1.0, -2.0, 0.5), (4.0, 5.0, 6.0)),
}
POSE = BodyPose(1, 2, 3.5, (1.5, -2.5, 0.5), (0.0, 0.0, 0.0, 1.0), 0.25)
TRAFFIC = TrafficSample((100.5, 200.5, 300.5), (10.5, 20.5, 30.5), 0.5, 7.5)

BYTES = {
    "peer packet, least": """
        0bdc001702030405a4686f6c64a66c656164657293cb3ff8000000000000cb4004000000000000cb400c00000000000093cb40120000
        00000000cb4016000000000000cb401a00000000000093cb401e000000000000cb4021000000000000cb4023000000000000cb3fb000
        0000000000cb40934a000000000007c09693cb4025000000000000cb4027000000000000cb402900000000000093cb00000000000000
        00cb0000000000000000cb000000000000000093cb0000000000000000cb0000000000000000cb00000000000000000000cb00000000
        00000000c0c0c0c3c0c0c09090
    """,
    "peer packet, whole": """
        0bdc001703ceffffffffce000f4240cfffffffffffffffffa9666f726d6174696f6ea8666f6c6c6f77657293cb3ff4000000000000cb
        4002000000000000cb400a00000000000093cb3fb999999999999acb3fc999999999999acb3fd333333333333393cb3f847ae147ae14
        7bcb3f947ae147ae147bcb3f9eb851eb851eb8cb3f95810624dd2f1bcb40b0e11000000000049601073ccb40290000000000000893cb
        3ff8000000000000cb3fe8000000000000cb3fd80000000000009693cbc008000000000000cb3fe0000000000000cb3fd00000000000
        0093cbbfe0000000000000cb3fc0000000000000cb3fb000000000000093cbbfe8000000000000cb3fc3333333333333cb3fd6666666
        6666660206cb401600000000000092cb3fd28f5c28f5c28fcb3fd1eb851eb851ec930b0ccb400c000000000000950992920293cbc000
        000000000000cb3ff0000000000000cb3fe0000000000000920393cbc010000000000000cbbff0000000000000cb3fd0000000000000
        cb404ec00000000000cb401e0000000000009105c29393cb4034800000000000cb4035800000000000cb403680000000000093cb4037
        800000000000cb4038800000000000cb403980000000000093cb403a800000000000cb403b800000000000cb403c80000000000092ce
        80000001c4406465666768696a6b6c6d6e6f707172737475767778797a7b7c7d7e7f808182838485868788898a8b8c8d8e8f90919293
        9495969798999a9b9c9d9e9fa0a1a2a392cb403d800000000000cb403e80000000000091940793cb403f800000000000cb4040400000
        000000cb4040c0000000000093cb3fd999999999999acb3fe0000000000000cb3fe3333333333333cb40414000000000009293cb4041
        c00000000000cb4042400000000000cb4042c0000000000093cb4043400000000000cb4043c00000000000cb4044400000000000
    """,
    "peer packet, relays a beacon to the east": """
        0bdc0017ccfa000000a76f627365727665a8666f6c6c6f77657293cb0000000000000000cb8000000000000000cb3f1a36e2eb1c432d
        93cbbff0000000000000cb3f50624dd2f1a9fccb000000000000000093cb0000000000000000cb0000000000000000cbc0239eb851eb
        851fcb0000000000000000cb0000000000000000ccf9960900cf0000010000000000cb000000000000000000c09693cb000000000000
        0000cb0000000000000000cb000000000000000093cb0000000000000000cb0000000000000000cb000000000000000093cb00000000
        00000000cb0000000000000000cb00000000000000000003cb0000000000000000c0930000cb0000000000000000c0c3c0c0c09090
    """,
    "status report, least": """
        0b82a6737461747573de002caa76656869636c655f696403a773657373696f6e01a5666c656574a7706c61746f6f6eae666f726d6174
        696f6e5f6861736805a36c6177a87765696768746564a57068617365a4686f6c64a96d6f64655f6e616d65ab4155544f2e4c4f495445
        52a561726d6564c3a66c616e64656402ae706f736974696f6e5f656e755f6d93cb3ff0000000000000cb4000000000000000cb400800
        0000000000b076656c6f636974795f656e755f6d5f7393cb4010000000000000cb4014000000000000cb4018000000000000ab737461
        74655f6167655f73cb3f947ae147ae147bb1686f7665725f7468727573745f6e6f726dcb3fdf5c28f5c28f5cb464697374757262616e
        63655f656e755f6d5f733293cb3ff0000000000000cbc000000000000000cb0000000000000000a4726f6c65a8666f6c6c6f776572a5
        65706f636807a370726302ad6c65616465725f626561636f6ec0b36c65616465725f626561636f6e5f6167655f73c0aa6e6569676862
        6f75727390a4736c6f7486ae706f736974696f6e5f656e755f6d93cbc008000000000000cb0000000000000000cb0000000000000000
        b076656c6f636974795f656e755f6d5f7393cb0000000000000000cb0000000000000000cb0000000000000000b5616363656c657261
        74696f6e5f656e755f6d5f733293cb0000000000000000cb0000000000000000cb0000000000000000a9666f726d6174696f6e00a777
        616974696e6700ab6d6f7665735f666f725f73cb0000000000000000af7265666572656e63655f656e755f6dc0a5666c61677390a872
        656a656374656480aa6c6173745f6576656e74c0ab7265666572656e63655f73cb0000000000000000a97265666572656e6365c0ac74
        61726765745f6167655f73c0ae726566757365735f72657475726ec0a56c61636b7390a6686f6c646572a0ae636f6d6d616e645f6e75
        6d62657200a5706565727390af626174746572795f70657263656e74c0ae706f736974696f6e5f6572726f72c0b06c6172676573745f
        737465705f646567cb0000000000000000a768656164696e6783a9616e676c655f726164cb0000000000000000aa726174655f726164
        5f73cb0000000000000000b3616363656c65726174696f6e5f7261645f7332cb0000000000000000aa73657061726174696f6e84a76e
        656172657374c0ac6368616e6765645f6d5f7332cb0000000000000000a876696f6c61746564c2a8756e7368616b656e90a76e657477
        6f726b82a87365637572697479a56c6f63616ca961646d697373696f6ec0a87761726e696e677390a77765696768747390b06e656967
        68626f75725f616765735f7390a97265636f7264696e6782a57374617465a36f6666a764726f7070656400a9646573637269626564c0
        a674696d696e6787a7726174655f687acb4049000000000000a57469636b73cd0bb8a66d697373656402a76c6174655f757383a37035
        30cb3ff0000000000000a3703939cb4000000000000000a36d6178cb4008000000000000b774656c656d657472795f746f5f636f6d6d
        616e645f757383a3703530cb4010000000000000a3703939cb4014000000000000a36d6178cb4018000000000000ab6370755f706572
        63656e74cb4014800000000000a67273735f6d62cb4048800000000000
    """,
    "status report, whole": """
        0b82a6737461747573de002caa76656869636c655f696404a773657373696f6ece80000000a5666c656574a7737761726d2d32ae666f
        726d6174696f6e5f68617368cf8000000000000000a36c6177a477696e64a57068617365a9666f726d6174696f6ea96d6f64655f6e61
        6d65a6475549444544a561726d6564c3a66c616e64656403ae706f736974696f6e5f656e755f6d93cb3ff8000000000000cb40040000
        00000000cb400c000000000000b076656c6f636974795f656e755f6d5f7393cb4012000000000000cb4016000000000000cb401a0000
        00000000ab73746174655f6167655f73cb3fa47ae147ae147bb1686f7665725f7468727573745f6e6f726dcb3fe0f5c28f5c28f6b464
        697374757262616e63655f656e755f6d5f733293cb3fd0000000000000cbbfe0000000000000cb0000000000000000a4726f6c65a66c
        6561646572a565706f636809a370726305ad6c65616465725f626561636f6e86a96c65616465725f696406a565706f636808a5737461
        6d7046ab7265666572656e63655f73cb402b000000000000a5636c61696d01a768656164696e6783a9616e676c655f726164cb3fe000
        0000000000aa726174655f7261645f73cb3fd0000000000000b3616363656c65726174696f6e5f7261645f7332cb3fc0000000000000
        b36c65616465725f626561636f6e5f6167655f73cb3faeb851eb851eb8aa6e65696768626f757273920208a4736c6f7486ae706f7369
        74696f6e5f656e755f6d93cbc00c000000000000cb3fe8000000000000cb3ff4000000000000b076656c6f636974795f656e755f6d5f
        7393cb3fc3333333333333cb3fd6666666666666cb3fdccccccccccccdb5616363656c65726174696f6e5f656e755f6d5f733293cb3f
        e199999999999acb3fe4cccccccccccdcb3feb333333333333a9666f726d6174696f6e0aa777616974696e670bab6d6f7665735f666f
        725f73cb4029000000000000af7265666572656e63655f656e755f6d93cb402d000000000000cb402f000000000000cb403080000000
        0000a5666c61677392ad4f5554534944455f46454e4345ab424154544552595f4c4f57a872656a656374656482a96d616c666f726d65
        6403a67265706c617904aa6c6173745f6576656e7482a4636f6465ad50484153455f4348414e474544a474657874b3656e6761676520
        2d3e20666f726d6174696f6eab7265666572656e63655f73cb4031800000000000a97265666572656e636583a5666c6f776e0da77761
        6974696e670ea7626567756e5f73cb4032800000000000ac7461726765745f6167655f73cb3fb47ae147ae147bae726566757365735f
        72657475726e82a4636f6465af52435f4f564552524944455f4f4646a474657874a36f6e65a56c61636b739182a4636f6465b346454e
        43455f414354494f4e5f554e53414645a474657874a374776fa6686f6c646572ab616e6e614067726f756e64ae636f6d6d616e645f6e
        756d6265720fa5706565727393020809af626174746572795f70657263656e74cb4054400000000000ae706f736974696f6e5f657272
        6f7282ac686f72697a6f6e74616c5f6dcb3fd3d70a3d70a3d7aa766572746963616c5f6dcb3fd7ae147ae147aeb06c6172676573745f
        737465705f646567cb3ffc000000000000a768656164696e6783a9616e676c655f726164cb3fe4000000000000aa726174655f726164
        5f73cb3fd4000000000000b3616363656c65726174696f6e5f7261645f7332cb3fc8000000000000aa73657061726174696f6e84a76e
        65617265737483a46e616d65a138aa64697374616e63655f6dcb4006000000000000aa72657175697265645f6dcb4004000000000000
        ac6368616e6765645f6d5f7332cb3fec000000000000a876696f6c61746564c3a8756e7368616b656e91a138a76e6574776f726b82a8
        7365637572697479a86964656e74697479a961646d697373696f6e10a87761726e696e67739182a4636f6465b247524f554e445f4c4f
        53535f414354494f4ea474657874a57468726565a77765696768747392cb3fd8000000000000cb3fe4000000000000b06e6569676862
        6f75725f616765735f7392cb3f9eb851eb851eb8cb3fa999999999999aa97265636f7264696e6782a57374617465a864726f7070696e
        67a764726f7070656411a964657363726962656485a46b696e64a6636972636c65ac63656e7472655f656e755f6d93cb000000000000
        0000cb3ff0000000000000cb4000000000000000a87261646975735f6d04a8706572696f645f73cb4034800000000000a6706f696e74
        739192cb3ff0000000000000cb4000000000000000a674696d696e6787a7726174655f687acb4049000000000000a57469636b73cd0b
        b8a66d697373656402a76c6174655f757383a3703530cb3ff0000000000000a3703939cb4000000000000000a36d6178cb4008000000
        000000b774656c656d657472795f746f5f636f6d6d616e645f757383a3703530cb4010000000000000a3703939cb4014000000000000
        a36d6178cb4018000000000000ab6370755f70657263656e74cb4014800000000000a67273735f6d62cb4048800000000000
    """,
    "command form": """
        0b85a46e616d65a4666f726da66e756d62657205a86f70657261746f72ab616e6e614067726f756e64a773657373696f6e06a7636f6e
        74656e74c0
    """,
    "command lead": """
        0b85a46e616d65a46c656164a66e756d62657207a86f70657261746f72ab616e6e614067726f756e64a773657373696f6e08a7636f6e
        74656e7483a474797065a44c656164a76c656164657273920204a565706f636809
    """,
    "command formation": """
        0b85a46e616d65a9666f726d6174696f6ea66e756d6265720aa86f70657261746f72ab616e6e614067726f756e64a773657373696f6e
        0ba7636f6e74656e7486a474797065af466f726d6174696f6e4368616e6765a66e756d62657209ab736c6f74735f656e755f6d929202
        93cbc000000000000000cb3ff0000000000000cb3fe0000000000000920393cbc010000000000000cbbff0000000000000cb3fd00000
        00000000a8626567696e735f73cb404ec00000000000a76c617374735f73cb401e000000000000a6616273656e749105
    """,
    "command reference": """
        0b85a46e616d65a97265666572656e6365a66e756d6265720ca86f70657261746f72ab616e6e614067726f756e64a773657373696f6e
        0da7636f6e74656e7484a474797065af5265666572656e63654368616e6765a66e756d62657203a97265666572656e636585a46b696e
        64a6636972636c65ac63656e7472655f656e755f6d93cb0000000000000000cb3ff0000000000000cb4000000000000000a872616469
        75735f6d04a8706572696f645f73cb4034800000000000a6706f696e74739192cb3ff0000000000000cb4000000000000000a8626567
        696e735f73cb4035800000000000
    """,
    "reply": """
        0b86aa76656869636c655f696403a66e756d62657209a86163636570746564c3a4636f6465ad50484153455f4348414e474544a67265
        61736f6ea6656e67616765a86f70657261746f72ab616e6e614067726f756e64
    """,
    "joystick": """
        0b85a773657373696f6e01a873657175656e636502a673656e745f73cb400c000000000000b076656c6f636974795f656e755f6d5f73
        93cb3ff0000000000000cb3fe0000000000000cb3fd0000000000000ae706f736974696f6e5f656e755f6dc0
    """,
    "target": """
        0b85a773657373696f6eceffffffffa873657175656e636507a673656e745f73cb4029000000000000b076656c6f636974795f656e75
        5f6d5f7393cb3ff0000000000000cbc000000000000000cb3fe0000000000000ae706f736974696f6e5f656e755f6d93cb4010000000
        000000cb4014000000000000cb4018000000000000
    """,
    "traffic": """
        0b85ae706f736974696f6e5f656e755f6d93cb4059200000000000cb4069100000000000cb4072c80000000000b076656c6f63697479
        5f656e755f6d5f7393cb4025000000000000cb4034800000000000cb403e800000000000a56167655f73cb3fe0000000000000a76572
        726f725f6dcb401e000000000000a6686569676874a5666c656574
    """,
    "pose": """
        0b86a773657373696f6e01a873657175656e636502a673656e745f73cb400c000000000000ae706f736974696f6e5f656e755f6d93cb
        3ff8000000000000cbc004000000000000cb3fe0000000000000aa7175617465726e696f6e94cb0000000000000000cb000000000000
        0000cb0000000000000000cb3ff0000000000000a56167655f73cb3fd0000000000000
    """,
}


@pytest.mark.parametrize("name", PACKETS)
def test_peer_packet(name: str) -> None:
    data = bytes.fromhex(BYTES[f"peer packet, {name}"])
    assert encode_peer(PACKETS[name]).hex() == data.hex()
    assert decode_peer(data) == PACKETS[name]


@pytest.mark.parametrize("name", REPORTS)
def test_status_report(name: str) -> None:
    data = bytes.fromhex(BYTES[f"status report, {name}"])
    assert encode(REPORTS[name]).hex() == data.hex()
    assert decode_report(data) == REPORTS[name]


@pytest.mark.parametrize("name", COMMANDS)
def test_command(name: str) -> None:
    data = bytes.fromhex(BYTES[f"command {name}"])
    assert encode(COMMANDS[name]).hex() == data.hex()
    assert decode_command(data) == COMMANDS[name]


def test_reply() -> None:
    data = bytes.fromhex(BYTES["reply"])
    assert encode(REPLY).hex() == data.hex()
    assert decode_reply(data) == REPLY


@pytest.mark.parametrize("name", TARGETS)
def test_target_sample(name: str) -> None:
    data = bytes.fromhex(BYTES[name])
    assert encode(TARGETS[name]).hex() == data.hex()
    assert decode_target(data) == TARGETS[name]


def test_traffic_sample() -> None:
    data = bytes.fromhex(BYTES["traffic"])
    assert encode(TRAFFIC).hex() == data.hex()
    assert decode_traffic(data) == TRAFFIC


def test_pose() -> None:
    data = bytes.fromhex(BYTES["pose"])
    assert encode(POSE).hex() == data.hex()
    assert decode_pose(data) == POSE


@pytest.mark.parametrize(
    "wrong",
    [{"position_enu_m": (nan, 0.0, 0.0)}, {"quaternion": (1.5, 0.0, 0.0, 0.0)}, {"age_s": 11.0}, {"sent_s": inf}],
    ids=str,
)
def test_pose_with_a_number_that_is_none_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(WireError) as refused:
        decode_pose(encode(replace(POSE, **wrong)))
    assert refused.value.code is Code.POSE_MALFORMED
