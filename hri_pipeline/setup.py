"""Tell catkin which Python packages this package holds; run by catkin, never by hand."""
from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

setup(**generate_distutils_setup(packages=find_packages("src"), package_dir={"": "src"},
                                 package_data={"hri_pipeline.models": ["*.yaml"]}))
