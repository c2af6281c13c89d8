"""One definition per message: memory of compiled code, row of the log, ROS 2 message, columns."""
