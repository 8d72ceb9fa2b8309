"""The store of people, opened as the parameters say."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Optional

import rospy

from hri_person_manager.core.record_store import StoreOfRecords
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.person_store import PersonStore
from hri_pipeline.core.recognition.stored_gallery import SHARED_ENDINGS


def open_store(settings: SimpleNamespace) -> Optional[StoreOfRecords]:
    """Open the file of the parameter `store` and say so; None without one.

    Raises ParameterError naming the parameter and the mend when the file cannot be used.
    """
    if not settings.store:
        rospy.loginfo("persons are kept in memory only (parameter store is empty)")
        return None
    if Path(settings.store).suffix not in SHARED_ENDINGS:
        raise ParameterError("~store: {} does not end in {}, by which recognisers know the file that they share; name it "
                             "so".format(settings.store, ", ".join(SHARED_ENDINGS)))
    try:
        store = PersonStore(settings.store, notify=rospy.logerr)
    except StoreError as error:
        raise ParameterError("~store: {}".format(error)) from error
    rospy.logwarn("persons are kept across runs in %s: ids, names, languages, apparent age and gender, times, templates of "
                  "faces. Forget them with `rosrun hri_person_manager people forget ID`", store.path)
    return StoreOfRecords(store, settings.store_max_age, settings.store_max_persons)
