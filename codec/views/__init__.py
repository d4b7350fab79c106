"""Cameras to score and to test with: held out, jittered, or planned from the splats."""
