"""The examples conform: their author's own tests are collected here."""

import test_plugins

TestSprings = test_plugins.TestSprings
TestUdpJsonCameras = test_plugins.TestUdpJsonCameras
TestGpioBoard = test_plugins.TestGpioBoard
