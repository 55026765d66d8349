"""One picture -> points that nobody measured: a network that has seen thousands of generated shapes says what the thing
may look like all around. Needs PyTorch; everything else here is numpy and OpenCV."""
