"""Definitions and type hashes of the ROS 2 messages in a log, by tools/make_message_definitions.py."""

from __future__ import annotations

from collections.abc import Iterator

SEPARATOR = "=" * 80 + "\n"


def schema_text(type_name: str) -> str:
    """Return the `ros2msg` schema: the definition of `type_name`, then of each type inside it."""
    parts = [DEFINITIONS[type_name]]
    inside = dict.fromkeys(_inside(type_name))
    parts += [f"MSG: {inner.replace('/msg/', '/')}\n{DEFINITIONS[inner]}" for inner in inside]
    return SEPARATOR.join(parts)


def _inside(type_name: str) -> Iterator[str]:
    """Yield the type of each field that is a message, and behind it those inside."""
    for line in DEFINITIONS[type_name].splitlines():
        package, slash, name = line.partition(" ")[0].partition("[")[0].partition("/")
        if slash:
            inner = f"{package}/msg/{name}"
            yield from (inner, *_inside(inner))


# Of each type in a log: its RIHS01 hash.
TYPE_HASHES: dict[str, str] = {
    "geometry_msgs/msg/PoseStamped": "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/msg/AccelStamped": "RIHS01_ef1df9eabae0a708cc049a061ebcddc4e2a5f745730100ba680e086a9698b165",
    "geometry_msgs/msg/WrenchStamped": "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "geometry_msgs/msg/Wrench": "RIHS01_018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52",
    "geometry_msgs/msg/Vector3Stamped": "RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
    "geometry_msgs/msg/InertiaStamped": "RIHS01_766be45976252babf7f9d8ac4ae7c912a7ceccf71035622529f27518b695aa09",
    "geometry_msgs/msg/QuaternionStamped": "RIHS01_381add86c6c3160644d228ca342182c7fd6c7fab11c7a85ad817a9cc22dbac6e",
    "sensor_msgs/msg/MagneticField": "RIHS01_e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "std_msgs/msg/Float64": "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "rosgraph_msgs/msg/Clock": "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "geometry_msgs/msg/Pose": "RIHS01_d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa",
    "geometry_msgs/msg/Twist": "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (
        "RIHS01_77b67434531e6529b7a0091357b186b6ebdb17fd9ffd3e0c7ce9d3fb11a44563"
    ),
    "geometry_msgs/msg/TransformStamped": "RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
}

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Time": """\
int32 sec
uint32 nanosec
""",
    "diagnostic_msgs/msg/DiagnosticArray": """\
std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
""",
    "diagnostic_msgs/msg/DiagnosticStatus": """\
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
""",
    "diagnostic_msgs/msg/KeyValue": """\
string key
string value
""",
    "geometry_msgs/msg/Accel": """\
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
""",
    "geometry_msgs/msg/AccelStamped": """\
std_msgs/Header header
geometry_msgs/Accel accel
""",
    "geometry_msgs/msg/Inertia": """\
float64 m
geometry_msgs/Vector3 com
float64 ixx
float64 ixy
float64 ixz
float64 iyy
float64 iyz
float64 izz
""",
    "geometry_msgs/msg/InertiaStamped": """\
std_msgs/Header header
geometry_msgs/Inertia inertia
""",
    "geometry_msgs/msg/Point": """\
float64 x
float64 y
float64 z
""",
    "geometry_msgs/msg/Pose": """\
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
""",
    "geometry_msgs/msg/PoseStamped": """\
std_msgs/Header header
geometry_msgs/Pose pose
""",
    "geometry_msgs/msg/PoseWithCovariance": """\
geometry_msgs/Pose pose
float64[36] covariance
""",
    "geometry_msgs/msg/PoseWithCovarianceStamped": """\
std_msgs/Header header
geometry_msgs/PoseWithCovariance pose
""",
    "geometry_msgs/msg/Quaternion": """\
float64 x
float64 y
float64 z
float64 w
""",
    "geometry_msgs/msg/QuaternionStamped": """\
std_msgs/Header header
geometry_msgs/Quaternion quaternion
""",
    "geometry_msgs/msg/Transform": """\
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
""",
    "geometry_msgs/msg/TransformStamped": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
""",
    "geometry_msgs/msg/Twist": """\
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
""",
    "geometry_msgs/msg/TwistStamped": """\
std_msgs/Header header
geometry_msgs/Twist twist
""",
    "geometry_msgs/msg/TwistWithCovariance": """\
geometry_msgs/Twist twist
float64[36] covariance
""",
    "geometry_msgs/msg/TwistWithCovarianceStamped": """\
std_msgs/Header header
geometry_msgs/TwistWithCovariance twist
""",
    "geometry_msgs/msg/Vector3": """\
float64 x
float64 y
float64 z
""",
    "geometry_msgs/msg/Vector3Stamped": """\
std_msgs/Header header
geometry_msgs/Vector3 vector
""",
    "geometry_msgs/msg/Wrench": """\
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
""",
    "geometry_msgs/msg/WrenchStamped": """\
std_msgs/Header header
geometry_msgs/Wrench wrench
""",
    "nav_msgs/msg/Odometry": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
""",
    "rosgraph_msgs/msg/Clock": """\
builtin_interfaces/Time clock
""",
    "sensor_msgs/msg/Imu": """\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    "sensor_msgs/msg/JointState": """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
""",
    "sensor_msgs/msg/MagneticField": """\
std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance
""",
    "std_msgs/msg/Float64": """\
float64 data
""",
    "std_msgs/msg/Header": """\
builtin_interfaces/Time stamp
string frame_id
""",
    "tf2_msgs/msg/TFMessage": """\
geometry_msgs/TransformStamped[] transforms
""",
}
