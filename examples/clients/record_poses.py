"""Write the poses of the tracker as CSV: record_poses.py SECONDS > poses.csv. Positions in m, quaternions w x y z."""

import sys
import time

from pcmrs.client import PlainClient
from pcmrs.messages import BodyPose

print("captured,body,x,y,z,qw,qx,qy,qz")


def write(pose: BodyPose) -> None:
    if pose.valid:
        print(pose.captured, pose.body, *pose.position, *pose.quat_wxyz, sep=",")


with PlainClient.connect() as cell:
    cell.listen("state/pose/*", BodyPose, write)
    time.sleep(float(sys.argv[1]))
