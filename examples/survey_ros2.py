"""A mission behind ROS 2 messages, without a dependency: callbacks take any objects with the fields."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import bojax


class MissionNode:
    """Odometry (`nav_msgs/Odometry`) and readings (`sensor_msgs/Range`) in, a path of positions out."""

    def __init__(self, mission: bojax.Mission, publish: Callable[[Any], None]):
        self.mission, self.publish, self.track, self.readings = mission, publish, [], []

    def on_odometry(self, message: Any) -> None:
        """Keep the position of the robot."""
        self.position = (message.pose.pose.position.x, message.pose.pose.position.y)

    def on_range(self, message: Any) -> None:
        """Keep a reading at the last position."""
        self.track.append(self.position)
        self.readings.append(message.range)

    def on_timer(self) -> None:
        """Tell the mission what was measured, and publish the plan for the rest."""
        self.mission.observe(self.track, self.readings, self.position)
        self.track, self.readings = [], []
        self.publish(self.mission.plan())


# In a node of rclpy: create_subscription(Odometry, "odom", node.on_odometry, 10), and so on.
# Here, messages are made by hand, and the first waypoint of each plan is reached at once.
plans = []
mission = bojax.Mission(bojax.Area.rectangle(0, 0, 50, 50), budget=120.0, start=[2, 2], spacing=2.0)
node = MissionNode(mission, plans.append)
x, y = 2.0, 2.0
for _ in range(3):
    position = SimpleNamespace(x=x, y=y)
    node.on_odometry(SimpleNamespace(pose=SimpleNamespace(pose=SimpleNamespace(position=position))))
    node.on_range(SimpleNamespace(range=4.0 + 0.1 * x))
    node.on_timer()
    x, y = (float(value) for value in plans[-1][0])
print(f"{len(plans)} plans; {mission.num_measurements} readings; {mission.remaining:.1f} m left")
