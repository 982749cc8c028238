import time

from esd.experiments import setting


def test_processor_time_of_a_resumed_training_is_that_of_all_its_steps():
    assert setting._cpu_seconds([(0, 5.0), (100, 7.0), (200, 9.0)]) == 4
    assert setting._cpu_seconds([(0, 5.0), (300, 5.5), (400, 7.5)]) == 8  # from step 200 on
    assert setting._cpu_seconds([(0, 5.0), (100, 7.0)]) == 2
    assert 0 <= setting._cpu_seconds([(0, time.process_time())]) < 1
