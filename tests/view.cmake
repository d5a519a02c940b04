# The viewer's page in headless Chromium: see test_view.sh. Skipped (77) without Chromium, npm or namespaces.
add_test(NAME view COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_view.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(view PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 400 RUN_SERIAL TRUE LABELS release_only)
add_test(NAME view_stop COMMAND /usr/bin/python3 ${CMAKE_CURRENT_SOURCE_DIR}/test_view_stop.py ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(view_stop PROPERTIES TIMEOUT 120)
