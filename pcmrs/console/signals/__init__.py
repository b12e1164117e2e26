"""What changes by itself: ages, joints, force, motion of tool and body, muscle, latency and what was dropped."""
