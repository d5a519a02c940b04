# The viewer's page in headless Chromium: see test_view.sh. 77: this machine has no Chromium, no npm or no namespaces.
foreach(part live log procedure probe)
    add_test(NAME view_${part} COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_view.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR} ${part})
endforeach()
set_tests_properties(view_live view_log view_procedure view_probe PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 900 LABELS release_only RESOURCE_LOCK chromium) # one draws with both processors
add_test(NAME view_stop COMMAND /usr/bin/python3 ${CMAKE_CURRENT_SOURCE_DIR}/test_view_stop.py ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(view_stop PROPERTIES TIMEOUT 120)
add_test(NAME view_hands COMMAND /usr/bin/python3 ${CMAKE_CURRENT_SOURCE_DIR}/test_view_hands.py ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(view_hands PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 240 LABELS release_only)
