"""Reading and writing scenes, cameras and masks."""
