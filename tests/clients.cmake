# The clients as programs: see test_clients.sh.
foreach(case bad_input replay balance figure)
    add_test(NAME clients_${case}
        COMMAND bash ${CMAKE_CURRENT_SOURCE_DIR}/test_clients.sh $<TARGET_FILE_DIR:trocar-replay> ${PROJECT_SOURCE_DIR} ${case})
    set_tests_properties(clients_${case} PROPERTIES TIMEOUT 240)
endforeach()
