"""Parameters of the bodies' kinematic models, a part of the tables of the nodes `bodies` and `vision`."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter

MODELLER_PARAMETERS = (
    Parameter("interface", "paper", "Kinematic tree of the bodies. paper: the 18 joints of the ROS4HRI paper, two at"
              " each hip. rep155: the 20 joints of REP-155, three at each hip.", choices=("paper", "rep155")),
    Parameter("ik_solver", "gauss_newton", "How the joints are found. gauss_newton: closed form, then a least-squares"
              " fit of the whole body; the most exact. closed_form: faster, noisier. ikpy: chains read from the URDF,"
              " 5 to 60 ms per body; for comparison.", choices=("gauss_newton", "closed_form", "ikpy")),
    Parameter("segments", "", "YAML file of the body's proportions. Empty: the package's own config/segments.yaml."),
    Parameter("limb_lengths", True, "Estimate the length of each limb. false: only the stature, with the proportions"
              " of the table; the fit is 2 to 4 mm worse, and the models look alike."),
    Parameter("stature_tolerance", 0.03, "Relative change of the stature from which a body's URDF is made anew (of a"
              " limb: what it makes of a thigh, 12 mm at 0.03). Smaller follows the estimate closer and restarts robot_state_publisher more"
              " often.", minimum=0.005, maximum=0.5),
    Parameter("stature_window", 5.0, "Time over which lengths are measured. Longer is calmer, shorter follows a"
              " body sooner whose first estimate was wrong.", unit="s", minimum=0.5, maximum=120.0),
    Parameter("model_delay", 0.0, "Least time of watching a body before its URDF is made. Longer gives a better first"
              " stature, and later first frames: robot_state_publisher takes 0.3 s as well.", unit="s", minimum=0.0, maximum=10.0),
    Parameter("min_keypoint_confidence", 0.3, "Confidence from which a key point is used for the model. Lower uses"
              " guessed points of hidden limbs.", minimum=0.0, maximum=1.0, live=True),
    Parameter("keypoint_agility", 1.0, "Factor of the accelerations that the key points' low pass expects: 1 is what"
              " was measured of people who walk, wash, punch and fence. Smaller trembles less and follows sudden motion"
              " later.", minimum=0.05, maximum=20.0, live=True),
    Parameter("keypoint_gate", 0.10, "Distance from where it is expected at which a key point of a resting limb is"
              " taken for an outlier. Smaller keeps out more wrong depths and holds back sudden motion.",
              unit="m", minimum=0.01, maximum=10.0, live=True),
)
"""What BodyModeller.from_parameters needs."""
