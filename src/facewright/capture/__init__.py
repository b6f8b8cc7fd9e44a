"""RGB-D recordings: readers of what depth cameras write, fusion of a recording into one smooth depth map, sensors."""
