# The clients as programs: see test_clients.sh.
foreach(case bad_input replay series golden balance figure hand bench)
    add_test(NAME clients_${case}
        COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_clients.sh $<TARGET_FILE_DIR:trocar-replay> ${PROJECT_SOURCE_DIR} ${case})
    set_tests_properties(clients_${case} PROPERTIES TIMEOUT 240)
endforeach()
set_tests_properties(clients_bench PROPERTIES RUN_SERIAL TRUE)
set_tests_properties(clients_hand PROPERTIES SKIP_RETURN_CODE 77 RUN_SERIAL TRUE LABELS release_only)
if(TROCAR_SANITIZE) # the simulation is many times slower then, the matrix product is not
    set_tests_properties(clients_bench PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=no")
endif()
add_test(NAME fit_friction COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_fit_friction.py
    $<TARGET_FILE_DIR:trocar-replay> ${PROJECT_SOURCE_DIR})
set_tests_properties(fit_friction PROPERTIES TIMEOUT 240 LABELS release_only)
add_test(NAME live_replay COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/live_replay.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(live_replay PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 60 RUN_SERIAL TRUE LABELS release_only)
add_test(NAME top COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_top.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(top PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 60 RUN_SERIAL TRUE LABELS release_only)
add_test(NAME hosts COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_hosts.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(hosts PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 60 RUN_SERIAL TRUE LABELS release_only)
add_test(NAME soak COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_soak.py ${PROJECT_SOURCE_DIR})
set_tests_properties(soak PROPERTIES LABELS release_only)
add_test(NAME spy COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_spy.sh ${PROJECT_BINARY_DIR} ${PROJECT_SOURCE_DIR})
set_tests_properties(spy PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 60 RUN_SERIAL TRUE LABELS release_only)
