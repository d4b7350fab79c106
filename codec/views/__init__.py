"""Cameras for scoring and testing: held out, jittered, or planned from the splats."""
