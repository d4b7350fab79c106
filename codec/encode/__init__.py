"""From a scene to an encoded scene: the pipeline, its profiles and its rate control."""
