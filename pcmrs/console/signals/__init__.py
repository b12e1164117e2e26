"""Values that change by themselves: ages, joints, force, motion of tool and body, muscle, latency, losses."""
