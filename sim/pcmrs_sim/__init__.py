"""A cell in software: MuJoCo arm, tracker, pointer and phantom behind the device protocols."""
