#!/usr/bin/env bash
# In a workspace built with colcon and sourced, with ROS 2 Jazzy: what the tests cannot do with the packages of PyPI.
#
#   source /opt/ros/jazzy/setup.bash && colcon build --packages-select rb_dynamics && source install/setup.bash
#   src/rb_dynamics/tools/check_in_jazzy.sh
#
# Launches the node and looks at it by the tools of ROS: ros2 topic, node, param, service and bag, tf2_echo, and the filter
# of robot_localization. Each check says ok, FAILED, or what is not here. Exits with 1 if one failed.
set -uo pipefail

export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-77} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
folder=$(mktemp -d)
failed=0
group=
trap 'stop; rm -rf "$folder"' EXIT

cat >"$folder/scene.yaml" <<'YAML'
body: {mass: 2.0, inertia: {diagonal: [1.0, 2.0, 2.5]}}
initial: {angular_velocity_body: [0.3, -0.2, 0.1], linear_velocity_world: [0.1, 0.0, 0.0]}
wrenches: [{topic: wrench, timeout: 1.0}]
solver: {method: rkmk4, step: 0.005}
output_rate: 100.0
YAML

cat >"$folder/filter.yaml" <<'YAML'
ekf_filter_node:
  ros__parameters:
    frequency: 50.0
    two_d_mode: false
    publish_tf: false
    map_frame: map
    odom_frame: world
    base_link_frame: body
    world_frame: world
    odom0: odom
    odom0_config: [true, true, true, true, true, true, true, true, true, true, true, true, false, false, false]
YAML

here() { command -v "$1" >/dev/null || { echo "not here: $1, for: $2"; return 1; }; }
package() { ros2 pkg prefix "$1" >/dev/null 2>&1 || { echo "not here: $1, for: $2"; return 1; }; }
check() { # NAME COMMAND...: says whether the command succeeds
    local name=$1
    shift
    if "$@" >"$folder/said" 2>&1; then
        echo "ok      $name"
    else
        echo "FAILED  $name"
        tail -n 5 "$folder/said" | sed 's/^/        /'
        failed=1
    fi
}
start() { # ARGUMENTS: launches the node in a process group of its own
    setsid ros2 launch rb_dynamics rigid_body.launch.py "scene:=$folder/scene.yaml" "$@" >"$folder/node" 2>&1 &
    group=$!
    timeout 20 ros2 topic echo --once /odom >/dev/null 2>&1 || { echo "FAILED  the node starts"; cat "$folder/node"; exit 1; }
}
stop() {
    [ -z "$group" ] || kill -INT -- "-$group" 2>/dev/null
    wait "$group" 2>/dev/null
    group=
}
number() { # TOPIC FIELD: prints it
    timeout 15 ros2 topic echo --once "$1" --field "$2" | grep -m1 -E -o -- '-?[0-9]+[0-9.e+-]*'
}
stamped_now() { # TOPIC: its stamp is within a second of the clock of the wall
    local sec
    sec=$(number "$1" header.stamp.sec)
    echo "stamped $sec"
    [ $(($(date +%s) - sec)) -le 1 ]
}
turns_faster() { # a commander of BEST_EFFORT QoS that stamps with now() turns the body
    timeout 4 ros2 topic pub -r 20 --qos-reliability best_effort /wrench geometry_msgs/msg/WrenchStamped \
        "{header: {stamp: now, frame_id: body}, wrench: {torque: {z: 5.0}}}" >/dev/null 2>&1
    awk -v rate="$(number /twist twist.angular.z)" 'BEGIN { print "turns at", rate; exit !(rate > 1.0) }'
}
transforms() { timeout 8 ros2 run tf2_ros tf2_echo world body | tee /dev/stderr | grep -q Translation; }
filters() { # the state of the filter follows the odometry within 0.2 m
    setsid ros2 run robot_localization ekf_node --ros-args --params-file "$folder/filter.yaml" >"$folder/filter" 2>&1 &
    local filter=$! x y
    sleep 3
    x=$(number /odometry/filtered pose.pose.position.x)
    y=$(number /odom pose.pose.position.x)
    kill -INT -- "-$filter" 2>/dev/null
    wait "$filter" 2>/dev/null
    awk -v x="$x" -v y="$y" 'BEGIN { print "filter", x, "odometry", y; exit !(x != "" && (x - y) ^ 2 < 0.04) }'
}
records() {
    timeout -s INT 5 ros2 bag record -s mcap -o "$folder/bag" /odom /wrench
    ros2 bag info "$folder/bag" && ros2 run rb_dynamics rb-dynamics inspect "$folder/bag"
}
plays() { timeout 30 ros2 bag play "$folder/bag" --topics /wrench; }

here ros2 "all of it: source a Jazzy" || exit 1
package rb_dynamics "all of it: build and source the workspace" || exit 1
start
check "messages carry ROS time" stamped_now /odom
check "ros2 node info knows it" ros2 node info /rigid_body
check "ros2 param list" ros2 param list /rigid_body
check "a BEST_EFFORT commander that stamps with now() turns the body" turns_faster
package robot_localization "the filter" && check "robot_localization follows it" filters
package rosbag2_storage_mcap "ros2 bag" && check "ros2 bag record, and inspect of the bag" records && check "ros2 bag play" plays
stop
package tf2_msgs "transforms" && package tf2_ros "transforms" && start publish_tf:=true &&
    check "tf2_echo finds the body" transforms
exit "$failed"
