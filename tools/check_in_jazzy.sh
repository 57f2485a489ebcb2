#!/usr/bin/env bash
# In a workspace built with colcon and sourced, with ROS 2 Jazzy: what the tests cannot do with the packages of PyPI.
#
#   source /opt/ros/jazzy/setup.bash && colcon build --packages-select rb_dynamics && source install/setup.bash
#   src/rb_dynamics/tools/check_in_jazzy.sh
#
# Launches the node and looks at it by the tools of ROS: ros2 topic, node, param, service and bag, tf2_echo, and the filter
# of robot_localization. Each check says ok, FAILED, or what is not here. Exits with 1 if one failed.
set -uo pipefail
# `ros2 bag` reads keys from a terminal, which would stop it in the background.
exec </dev/null

export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-77} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
folder=$(mktemp -d)
failed=0
group=
trap 'stop; rm -rf "$folder"' EXIT

cat >"$folder/scene.yaml" <<'YAML'
body: {mass: 2.0, inertia: {diagonal: [1.0, 2.0, 2.5]}}
initial: {position_world: [3, 0, 0], angular_velocity_body: [0.3, -0.2, 0.1], linear_velocity_world: [0.01, 0, 0]}
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
    [ -n "$(number /odom nav_msgs/msg/Odometry header.stamp.sec)" ] ||
        { echo "FAILED  the node starts"; cat "$folder/node"; exit 1; }
}
stop() {
    [ -z "$group" ] || kill -- "-$group" 2>/dev/null
    wait "$group" 2>/dev/null
    group=
}
number() { # TOPIC TYPE FIELD: prints it; without the type, ros2 topic does not wait for a topic that is not there yet
    timeout 30 ros2 topic echo --once "$1" "$2" --field "$3" | grep -m1 -E -o -- '-?[0-9]+[0-9.e+-]*'
}
stamped_now() { # /odom is stamped by the clock of the wall
    local before sec after
    before=$(date +%s)
    sec=$(number /odom nav_msgs/msg/Odometry header.stamp.sec)
    after=$(date +%s)
    echo "stamped $sec, looked at from $before to $after"
    [ "$sec" -ge "$((before - 1))" ] && [ "$sec" -le "$after" ]
}
commands() { # SECONDS TORQUE: a commander of BEST_EFFORT QoS that stamps with now()
    timeout "$1" ros2 topic pub -r 20 --qos-reliability best_effort /wrench geometry_msgs/msg/WrenchStamped \
        "{header: {stamp: now, frame_id: body}, wrench: {torque: {z: $2}}}" >/dev/null 2>&1
}
turns_faster() {
    commands 8 5.0
    awk -v rate="$(number /twist geometry_msgs/msg/TwistStamped twist.angular.z)" \
        'BEGIN { print "turns at", rate; exit !(rate + 0 > 1.0) }'
}
answers() { ros2 service call /rigid_body/pause std_srvs/srv/SetBool "{data: $1}" | tee /dev/stderr | grep 'success=True'; }
moved() { # by parameters, with an answer
    ros2 param set /rigid_body state.position_world '[3.0, 7.0, 0.0]' &&
        awk -v y="$(number /odom nav_msgs/msg/Odometry pose.pose.position.y)" \
            'BEGIN { print "at", y; exit !((y - 7.0) ^ 2 < 0.04) }'
}
transforms() { # tf2_echo ends with its time
    timeout -s INT 8 ros2 run tf2_ros tf2_echo world body >"$folder/transforms" 2>&1
    cat "$folder/transforms"
    grep -q Translation "$folder/transforms"
}
filters() { # the state of the filter follows the odometry; it starts at 0
    setsid ros2 run robot_localization ekf_node --ros-args --params-file "$folder/filter.yaml" >"$folder/filter" 2>&1 &
    local filter=$! x y
    x=$(number /odometry/filtered nav_msgs/msg/Odometry pose.pose.position.x)
    y=$(number /odom nav_msgs/msg/Odometry pose.pose.position.x)
    kill -- "-$filter" 2>/dev/null
    wait "$filter" 2>/dev/null
    awk -v x="$x" -v y="$y" 'BEGIN { print "filter", x, "odometry", y; exit !(x != "" && y != "" && (x - y) ^ 2 < 0.04) }'
}
contents() { # the recorder leaves out what nobody publishes
    commands 12 -2.0 &
    timeout -s INT 10 ros2 bag record -s mcap -o "$folder/bag" --topics /odom /wrench
    wait $!
    ros2 bag info "$folder/bag" | tee /dev/stderr | grep -E 'Topic: /wrench .*Count: [1-9]'
}
accepted() {
    timeout 30 ros2 topic echo --once -f /diagnostics diagnostic_msgs/msg/DiagnosticArray |
        grep -A 1 "wrench: accepted" | grep -E -o '[0-9]+'
}
plays() { # what is played reaches the node
    local before after
    before=$(accepted)
    timeout 60 ros2 bag play "$folder/bag" --topics /wrench
    sleep 2
    after=$(accepted)
    echo "commands accepted: before $before, after $after"
    [ "$after" -gt "$before" ]
}

here ros2 "all of it: source a Jazzy" || exit 1
package rb_dynamics "all of it: build and source the workspace" || exit 1
start
check "messages carry ROS time" stamped_now
package robot_localization "the filter" && check "robot_localization follows it" filters
check "ros2 node info knows it" ros2 node info /rigid_body
check "ros2 param list" ros2 param list /rigid_body
check "ros2 service call pauses it" answers true
check "ros2 service call lets it go on" answers false
check "ros2 param set moves it" moved
check "a BEST_EFFORT commander that stamps with now() turns the body" turns_faster
package rosbag2_storage_mcap "ros2 bag" && check "ros2 bag record" contents &&
    check "inspect of the bag" ros2 run rb_dynamics rb-dynamics inspect "$folder/bag" && check "ros2 bag play" plays
stop
package tf2_msgs "transforms" && package tf2_ros "transforms" && start publish_tf:=true &&
    check "tf2_echo finds the body" transforms
exit "$failed"
