"""Controls that know none of our types, described by a mapping file; nothing here imports ROS."""
