"""Figures published in Foveated Path Culling (FPC).

Its frame rates are those of its own scene and renderers on an RTX 3060: ratios are comparable with ours,
times are not.
"""

# (width, height): frames per second of FPC and of its path tracing. Tables 4 and 5.
TABLE_4 = {
    (800, 600): (265.4, 330.2),
    (1012, 1061): (195.2, 152.0),
    (1954, 1061): (107.0, 77.7),
    (3316, 1061): (66.5, 46.4),
}
TABLE_5 = {
    (782, 820): (248.4, 253.1),
    (859, 900): (224.0, 210.0),
    (930, 975): (211.2, 180.5),
    (1012, 1061): (195.2, 152.0),
}
# Radius in percent of the height up to which FPC is faster than path tracing: Figures 8, 9, 10 and 7. In
# Figure 7 it is faster up to the largest radius.
BREAK_EVEN = {(1280, 780): 51.0, (1012, 1061): 50.0, (1954, 1061): 85.0, (3316, 1061): 90.0}
# Samples per pixel: frames per second by radius in percent. Path tracing has 150 at one sample (Figure 14).
FIGURE_14 = {1: {10: 200, 90: 100}, 2: {10: 192, 90: 67}, 4: {10: 166, 90: 40}, 6: {10: 151, 90: 30}}
FIGURE_14_FULL = 150.0
FIGURE_14_SIZE, FIGURE_14_RADII = (1012, 1061), (10, 20, 50, 90)
# Frame sizes of Figures 12 and 13.
VIEW_SIZES = ((1280, 780), (3316, 1061))
